"""Pairing of the images of several cameras by the numbers in their names."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatreel.base.errors import CaptureError
from splatreel.capture.files import natural_key
from splatreel.capture.gaps import used_steps
from splatreel.capture.image_times import NUMBER, TICK, moments

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
    """Pair images that have no numbers in common in their order."""
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
    """Return a sentence about numbers that no camera has."""
    apart = np.diff(labels)
    # Numbers of at least a tick are times, which are rounded.
    usual = apart.min(initial=1) if len(apart) == 0 or apart.min() < TICK else 1.5 * np.median(apart)
    wide = np.flatnonzero(apart > usual)
    if not len(wide):
        return []
    at, count = int(wide[0]), len(wide)
    more = f", and {count - 1} more gaps" if count > 1 else ""
    return [f"no camera has images between {labels[at]} and {labels[at + 1]}{more}: the video jumps there"]
