"""Time steps of a capture: the frames that show them, images that are paired by their names, and gaps."""

from __future__ import annotations

import os
import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np

from splatreel.base.errors import CaptureError
from splatreel.capture.files import natural_key


@dataclass(frozen=True)
class OwnFrames:
    """Frames that a camera's files hold.

    Attributes:
        numbers: Number of the frame that each time step shows, [T] int. Frames are counted from 0.
        count: Number of frames.
        stems: Names of the images without their suffixes; None for a video.
    """

    numbers: np.ndarray
    count: int
    stems: Sequence[str] | None = None


@runtime_checkable
class CountedSource(Protocol):
    """Source of images that knows the frames of its cameras."""

    def own_frames(self, name: str) -> OwnFrames:
        """Return the frames of a camera's files."""
        ...


OUT_OF_STEP = 0.6
"""Maximum difference between a time step and a frame that shows it, in frames. Beyond, the frame is missing."""
MOST_NAMED = 4
"""Maximum number of cameras and of stretches of frames that a sentence lists."""


def used_steps(exists: Mapping[str, np.ndarray]) -> tuple[int, int]:
    """Return the first and the end of the time steps to use: from the first to the last that most cameras have.

    A camera that lacks frames costs the others none of theirs. Steps beyond, with few cameras, cannot be reconstructed.

    Args:
        exists: By camera [steps] bool, whether the camera has a frame.
    """
    if not exists:
        return 0, 0
    counts = np.stack(list(exists.values())).sum(0)
    most = np.flatnonzero(2 * counts > len(exists))
    return (int(most[0]), int(most[-1]) + 1) if len(most) else (0, 0)


def nearest(exists: np.ndarray) -> np.ndarray:
    """Return for each step the nearest one with a frame, [steps] int64; the earlier of two. At least one must have a frame."""
    there = np.flatnonzero(exists)
    return there[np.searchsorted((there[1:] + there[:-1]) / 2, np.arange(len(exists)))]


def describe_gaps(missing: Mapping[str, np.ndarray], labels: Sequence[int], noun: str) -> list[str]:
    """Return a sentence about the frames that cameras lack, or nothing.

    Args:
        missing: By camera [steps] bool.
        labels: Numbers of the steps, as users know them.
        noun: Noun for the frames, in the plural.
    """
    gaps = {name: np.flatnonzero(mask) for name, mask in missing.items() if mask.any()}
    if not gaps:
        return []
    named = [f"{name} has no {noun} {_stretches(steps, labels)}" for name, steps in list(gaps.items())[:MOST_NAMED]]
    more = f"; {len(gaps) - MOST_NAMED} more cameras have gaps" if len(gaps) > MOST_NAMED else ""
    return [f"{'; '.join(named)}{more}: left out of training for that camera only"]


def _stretches(steps: np.ndarray, labels: Sequence[int]) -> str:
    """Return `5, 7-9` for steps, with the count of further ones."""
    runs = np.split(steps, np.flatnonzero(np.diff(steps) > 1) + 1)
    texts = [f"{labels[run[0]]}-{labels[run[-1]]}" if len(run) > 1 else f"{labels[run[0]]}" for run in runs]
    rest = sum(len(run) for run in runs[MOST_NAMED:])
    return ", ".join(texts[:MOST_NAMED]) + (f" and {rest} more" if rest else "")


NUMBER = re.compile("([0-9]+)")
TICK = 10
"""Minimum usual step of numbers that may be times, which differ a little between the cameras at the same moment."""
TOGETHER, SPREAD = 0.25, 0.5
"""Maximum difference of consecutive times of one moment, and of all of its times, as shares of the usual step."""
DENSE = 0.5
"""Share of the numbers up to the highest above which digits behind a point are a number of their own, not decimals."""

Keys = dict[str, list[tuple[int, ...]]]
"""Keys of the images by camera. Images of the same moment have the same key, and keys are in order of time."""


def moments(path: str, names: Mapping[str, list[str]], notes: list[str]) -> Keys | None:
    """Return the moments of images by camera, or None if names have no numbers that can be compared.

    Args:
        path: Folder of the capture, for messages.
        names: Names of each camera's images, without extension.
        notes: Sentences about choices, which are added to.

    Raises:
        CaptureError: Times of different moments cannot be told apart.
    """
    numbers = {name: [NUMBER.findall(own) for own in found] for name, found in names.items()}
    places = _varying(numbers)
    if places is None:
        return None
    keys = {name: [tuple(int(row[at]) for at in places[name]) for row in rows] for name, rows in numbers.items()}
    times = _decimals(names, numbers, places) or _best_column(keys)
    return keys if times is None else _merged(path, times, notes)


def _varying(numbers: Mapping[str, list[list[str]]]) -> dict[str, list[int]] | None:
    """Return by camera the places of the numbers that differ between its images; None where names cannot be compared so.

    Args:
        numbers: By camera, the numbers in the name of each image.
    """
    if any(len({len(row) for row in rows}) > 1 for rows in numbers.values()):
        return None
    own = {
        name: [at for at, column in enumerate(zip(*rows, strict=True)) if len(set(map(int, column))) > 1]
        for name, rows in numbers.items()
    }
    if len({len(rows[0]) for rows in numbers.values()}) == 1:
        together = sorted({at for places in own.values() for at in places})
        own = dict.fromkeys(own, together)
    return own if len({len(places) for places in own.values()}) == 1 and all(own.values()) else None


def _decimals(
    names: Mapping[str, list[str]], numbers: Mapping[str, list[list[str]]], places: Mapping[str, list[int]]
) -> dict[str, list[int]] | None:
    """Return numbers with decimals as multiples of their last digit; None if no point is in the names, or is not a decimal point."""
    digits: list[str] = []
    wholes: dict[str, int] = {}
    for name, rows in numbers.items():
        last, gaps = places[name][-1], NUMBER.split(names[name][0])[2:-1:2]
        if last == 0 or gaps[last - 1] != "." or not set(places[name]) <= {last - 1, last}:
            return None
        wholes[name] = last - 1
        digits += [row[last] for row in rows]
    values = {int(text) for text in digits}
    lengths = {len(text) for text in digits}
    if len(lengths) > 1 and len(values) >= DENSE * (max(values) + 1):
        return None  # such as 1.9, 1.10
    most = max(lengths)
    times = {
        name: [int(row[wholes[name]] + row[wholes[name] + 1].ljust(most, "0")) for row in rows]
        for name, rows in numbers.items()
    }
    return times if all(len(set(found)) == len(found) for found in times.values()) else None


def _best_column(keys: Keys) -> dict[str, list[int]] | None:
    """Return the numbers that most cameras have in common, of those that give the same order as all numbers of the names."""
    best, most = None, -1
    for at in range(len(next(iter(keys.values()))[0])):
        column = {name: [row[at] for row in rows] for name, rows in keys.items()}
        ordered = ([row[at] for row in sorted(rows)] for rows in keys.values())
        if all(one < other for found in ordered for one, other in pairwise(found)):
            shared = _shared(column.values())
            if shared > most:
                best, most = column, shared
    return best if most >= _shared(keys.values()) else None


def _shared(found: Iterable[Sequence[object]]) -> int:
    """Return the number of values that more than half of the cameras have."""
    cameras = [set(values) for values in found]
    counts = Counter(value for values in cameras for value in values)
    return sum(2 * count > len(cameras) for count in counts.values())


def _merged(path: str, times: Mapping[str, list[int]], notes: list[str]) -> Keys:
    """Return one key for times of the same moment, which differ between cameras by less than a frame."""
    distinct = sorted({time for found in times.values() for time in found})
    steps = [float(np.median(np.diff(sorted(found)))) for found in times.values() if len(found) > 1]
    step = float(np.median(steps)) if steps else 0.0
    if step < TICK or all(set(found) == set(distinct) for found in times.values()):
        return {name: [(time,) for time in found] for name, found in times.items()}
    groups = np.split(np.array(distinct), np.flatnonzero(np.diff(distinct) > TOGETHER * step) + 1)
    first = {int(time): int(group[0]) for group in groups for time in group}
    spread = max(int(group[-1] - group[0]) for group in groups)
    merged = {name: [(first[time],) for time in found] for name, found in times.items()}
    if spread > SPREAD * step or any(len(set(found)) < len(found) for found in merged.values()):
        raise CaptureError(
            f"{path}: the numbers of images are {step:g} apart and differ by up to {spread} between cameras, so that it is not "
            f"clear which images belong together. Give images of the same moment the same number."
        )
    if spread:
        notes.append(
            f"numbers of images of the same moment differ by up to {spread} between cameras, where images are {step:g} apart"
        )
    return merged


MOST_STRAY = 0.25
"""Maximum share of the images of a folder whose names may differ from the others' by more than numbers. They are skipped."""
MOST_STEPS = 1.5
"""Maximum number of time steps, as a multiple of the images of the camera that has most."""

Key = tuple[int | str, ...]


@dataclass(frozen=True)
class ImagePairs:
    """Images of all cameras by time step.

    Attributes:
        files: By camera a file per time step; None where the camera has none.
        notes: Sentences about skipped files and numbers.
        labels: Number of each time step; None where the names have none.
    """

    files: Mapping[str, list[Path | None]]
    notes: list[str]
    labels: list[int] | None = None


def pair_images(path: Path, files: Mapping[str, list[Path]], all_have: bool = False) -> ImagePairs:
    """Return the images of each time step: those with the same number.

    Numbers are those parts of the names that differ between the images of one camera. Images without numbers are
    paired by name. If the cameras have no numbers in common, the images are paired in their order.

    Args:
        path: Folder of the capture, for messages.
        files: Images by camera.
        all_have: Use only time steps up to the end of the shortest camera.

    Raises:
        CaptureError: Two images of a camera have the same number, the names of a folder are of several kinds, or the
            cameras have neither numbers in common nor equally many images.
    """
    if all(len(found) == 1 for found in files.values()):
        return ImagePairs({name: list(found) for name, found in files.items()}, [])
    notes: list[str] = []
    kept = {name: _of_one_kind(name, found, notes) for name, found in files.items()}
    keyed = _keyed(path, kept, notes)
    steps = sorted({key for found in keyed.values() for key in found})
    exists = {name: np.array([key in found for key in steps]) for name, found in keyed.items()}
    first, end = used_steps(exists)
    if all_have:
        end = min(int(np.flatnonzero(there)[-1]) + 1 for there in exists.values())
    if end <= first:
        return _in_order(path, kept, notes)
    chosen = steps[first:end]
    _check_common(path, kept, {name: int(there[first:end].sum()) for name, there in exists.items()}, len(chosen))
    labels = [key[0] if len(key) == 1 and isinstance(key[0], int) else step for step, key in enumerate(chosen)]
    notes += _skipped_numbers(labels)
    if left := len(steps) - len(chosen):
        notes.append(f"{left} time steps at the ends, for which most cameras have no image, are not used")
    return ImagePairs({name: [found.get(key) for key in chosen] for name, found in keyed.items()}, notes, labels)


def _check_common(path: Path, files: Mapping[str, list[Path]], used: Mapping[str, int], steps: int) -> None:
    """Refuse cameras whose images have few numbers in common.

    Args:
        path: Folder of the capture, for messages.
        files: Images by camera.
        used: Number of images in the time steps by camera.
        steps: Number of time steps.
    """
    low, high = min(used, key=lambda name: used[name]), max(used, key=lambda name: used[name])
    if used[low] and steps <= MOST_STEPS * used[high]:
        return
    other = high if low != high else next(name for name in used if name != low)
    why = f"{steps} different numbers" if used[low] else f"no number of {low} in common with most cameras"
    raise CaptureError(
        f"{path}: images of the cameras do not belong together by their numbers, with {why}: {files[low][0].name} is the first of "
        f"{low}, {files[other][0].name} of {other}. Give images of the same moment the same number."
    )


def _of_one_kind(camera: str, files: list[Path], notes: list[str]) -> list[Path]:
    """Return the images whose names differ only by numbers, and note skipped ones. Names without numbers are all kept."""
    kinds: dict[tuple[str, ...], list[Path]] = defaultdict(list)
    for file, name in zip(files, _names(files), strict=True):
        kinds[tuple(NUMBER.split(name)[::2])].append(file)
    if len(kinds) == 1 or all(len(kind) == 1 for kind in kinds):
        return files
    most = max(kinds.values(), key=len)
    stray = [file for file in files if file not in most]
    if len(stray) > MOST_STRAY * len(files):
        raise CaptureError(
            f"{files[0].parent}: holds images of several kinds, such as {most[0].name} and {stray[0].name}. Leave those of one "
            f"kind, numbered in order of time, and move the others elsewhere."
        )
    notes.append(
        f"{camera}: {len(stray)} images such as {stray[0].name} are skipped, since others are like {most[0].name}"
    )
    return most


def _keyed(path: Path, files: Mapping[str, list[Path]], notes: list[str]) -> dict[str, dict[Key, Path]]:
    """Return the images of each camera by their moments, or by their whole names."""
    names = {name: _names(found) for name, found in files.items()}
    keys: Mapping[str, Sequence[Key]] | None = moments(str(path), names, notes)
    if keys is None:
        keys = {name: [natural_key(own) for own in found] for name, found in names.items()}
    return {name: _unique(list(zip(keys[name], found, strict=True))) for name, found in files.items()}


def _names(files: list[Path]) -> list[str]:
    """Return the names of a camera's images without extension, with the folders that they do not have in common."""
    base = os.path.commonpath([file.parent for file in files])
    return [file.relative_to(base).with_suffix("").as_posix() for file in files]


def _unique(pairs: list[tuple[Key, Path]]) -> dict[Key, Path]:
    found: dict[Key, Path] = {}
    for key, file in pairs:
        if key in found:
            raise CaptureError(
                f"{file.parent}: {found[key].name} and {file.name} are of the same time step. Remove one of them."
            )
        found[key] = file
    return found


def _in_order(path: Path, files: Mapping[str, list[Path]], notes: list[str]) -> ImagePairs:
    counts = {name: len(found) for name, found in files.items()}
    low, high = min(counts, key=lambda n: counts[n]), max(counts, key=lambda n: counts[n])
    if counts[low] < counts[high]:
        raise CaptureError(
            f"{path}: most cameras have no image numbers in common, and unequal numbers of images: {low} has {counts[low]}, from "
            f"{files[low][0].name} on, {high} has {counts[high]}, from {files[high][0].name} on. Give images of the same moment the "
            f"same number."
        )
    example = f"{files[low][0].name} of {low}"
    notes.append(
        f"images are paired in their order, since the cameras have no numbers in common ({example} is the first)"
    )
    return ImagePairs({name: list(found) for name, found in files.items()}, notes)


def _skipped_numbers(labels: list[int]) -> list[str]:
    apart = np.diff(labels)
    # Numbers of at least a tick are times, which are rounded.
    usual = apart.min(initial=1) if len(apart) == 0 or apart.min() < TICK else 1.5 * np.median(apart)
    wide = np.flatnonzero(apart > usual)
    if not len(wide):
        return []
    at, count = int(wide[0]), len(wide)
    more = f", and {count - 1} more gaps" if count > 1 else ""
    return [f"no camera has images between {labels[at]} and {labels[at + 1]}{more}: the video jumps there"]
