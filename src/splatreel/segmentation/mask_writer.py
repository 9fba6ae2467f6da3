"""Masks of the subject of a capture, written as images that `--masks` reads. An interrupted call continues."""

from __future__ import annotations

import io
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from PIL import Image

from splatreel.base import threads
from splatreel.base.atomic import remove, sweep, write_bytes
from splatreel.base.errors import CaptureError
from splatreel.base.progress import Progress
from splatreel.base.untrusted import check_regular
from splatreel.capture.file_capture import FileCapture
from splatreel.capture.files import LOCAL
from splatreel.capture.images import encode_image
from splatreel.capture.mask_shares import describe_shares
from splatreel.capture.masks import DOUBT, RECORD, read_mask_record
from splatreel.capture.time_steps import CountedSource
from splatreel.method.images.people import People, how_to_install
from splatreel.method.layering.masks import Segmenter
from splatreel.segmentation.clean_plate import fitting_plates, read_clean_plates
from splatreel.segmentation.segmenter import FIT_STEPS, SubjectModel, fit_subject

SAMPLES = 30
"""Number of moments, spread over the video, from which backgrounds are learned."""
CHUNK = 8
"""Number of moments that are read at a time."""
STANDING = 0.0005
"""Share of an image that somebody who never moves must cover to be reported."""
DISAGREEING = 0.3
"""Area in doubt, relative to that of the subject, above which a camera is reported."""
FAINTEST = 0.0005
"""Smallest share of the images that a subject covers, at least in one camera and moment."""
VERSION = 6
NOTHING_MOVES = (
    "nothing moves in this capture, so there is no subject to find. If somebody stands still, film the scene without them, and give "
    "these images or videos with --clean-plate FOLDER."
)
NOTHING_DIFFERS = (
    "nothing differs from the clean plate, so there is no subject to find. Check that the plate shows the scene without the "
    "subject."
)
MODEL = ".model.npz"
"""File of the backgrounds, which an interrupted call leaves for the next."""


@dataclass(frozen=True)
class WrittenMasks:
    """Result of `write_masks`.

    Attributes:
        images: Number of images that were written now.
        shares: Mean share of the subject in the images of each camera, 0..1.
        notes: Sentences about doubtful masks.
    """

    images: int
    shares: dict[str, float]
    notes: list[str]


def write_masks(
    capture: FileCapture,
    folder: Path,
    progress: Progress,
    clean_plate: Path | None = None,
    segmenter: Segmenter | None = None,
    people: People | None = None,
) -> WrittenMasks:
    """Write a mask for each frame and camera of a capture: FOLDER/CAMERA/NAME.png, named as the camera's own images.

    Images that exist are kept, so masks that were corrected by hand stay.

    Args:
        capture: The capture, at the size at which masks are made.
        folder: Folder of the masks. It is new, empty, or holds masks of the same capture.
        progress: Progress display.
        clean_plate: Folder with images without the subject; None finds backgrounds in the capture itself.
        segmenter: Network that completes the masks of each moment.
        people: Networks that find people. A call that continues masks made without them goes on without them.

    Raises:
        CaptureError: The capture is still growing, nothing moves, or the folder belongs to another capture.
    """
    source = capture.source
    if capture.growing or not isinstance(source, CountedSource):
        raise CaptureError(f"{capture.path}: is still being written. Make masks when the capture is complete.")
    plan = _plan(capture, source, folder)
    record = _claim(capture, folder, clean_plate, people is not None)
    if record.get("complete") and all(file.exists() for files in plan.values() for file in files.values()):
        return WrittenMasks(0, record["shares"], record["notes"])
    if record["people"] and people is None:
        raise CaptureError(
            f"{folder}: was begun with networks of people, which are not installed now. Run {how_to_install()}, or name a new folder."
        )
    people = people if record["people"] else None
    model, notes = _model(capture, folder, clean_plate, progress, people)
    names = [camera.name for camera in capture.cameras]
    notes += _standing(names, model)
    if people is None:
        notes.append(f"people were found by motion and colors only. Networks find them better: {how_to_install()}")
    written, covered = 0, []
    progress.stage("writing masks", len(plan))
    for steps in _chunks(list(plan)):
        wanted = [(t, c, file) for t, step in enumerate(steps) for c, file in plan[step].items() if not file.exists()]
        if wanted:
            masks = _masks(capture, model, steps, segmenter)
            threads.map_parallel(lambda job, masks=masks: _save(job[2], masks[job[0], job[1]]), wanted)
            written += len(wanted)
        for step in steps:
            unread = np.nan, np.nan
            covered.append([_shares(plan[step][c]) if c in plan[step] else unread for c in range(len(names))])
        progress.update(len(covered))
    shares, doubtful = np.moveaxis(np.array(covered), 2, 0)
    means = dict(zip(names, np.nanmean(shares, 0).tolist(), strict=True))
    notes += _disagreeing(names, np.nanmean(shares, 0), np.nanmean(doubtful, 0))
    by_step = dict(zip(plan, shares.tolist(), strict=True))
    within = range(capture.first_frame, capture.first_frame + capture.frames)
    unseen = [np.nan] * len(names)
    notes += describe_shares(names, np.array([by_step.get(step, unseen) for step in within]), capture.first_frame)[1:]
    _write_record(folder, record | {"complete": True, "shares": means, "notes": notes})
    remove(folder / MODEL)
    return WrittenMasks(written, means, notes)


def _masks(capture: FileCapture, model: SubjectModel, steps: list[int], segmenter: Segmenter | None) -> np.ndarray:
    names = [camera.name for camera in capture.cameras]
    before, after = min(steps[0], 1), min(capture.source.frames - steps[-1] - 1, 1)
    first, count = steps[0] - before, before + len(steps) + after
    frames = capture.read_any(first, count, names)
    own = slice(before, before + len(steps))
    masks = model.masks(frames, _existing(capture, first, count))[own]
    if segmenter is None:
        return masks
    pairs = zip(masks, frames[own], strict=True)
    completed = np.stack([segmenter.complete(mask > 127, images) for mask, images in pairs])
    return model.with_border_opacity(np.where(completed, np.uint8(255), np.uint8(0)), frames[own])


def _existing(capture: FileCapture, first: int, count: int) -> np.ndarray:
    """Return which cameras have images of time steps, [count, C] bool. Others have those of other time steps in their place."""
    return ~np.stack([capture.source.missing(first, count, camera.name) for camera in capture.cameras], 1)


def _plan(capture: FileCapture, source: CountedSource, folder: Path) -> dict[int, dict[int, Path]]:
    """Return the files to write by time step and number of the camera. Time steps count from the first one of the files.

    Each image that the frame range uses gets one mask, of a time step at which the camera filmed it. An image that only stands in for
    a missing one within the range has a mask of its own time step, outside of the range.
    """
    plan: dict[int, dict[int, Path]] = {}
    within = range(capture.first_frame, capture.first_frame + capture.frames)
    exists = _existing(capture, 0, capture.source.frames)
    for c, camera in enumerate(capture.cameras):
        own = source.own_frames(camera.name)
        shown = {int(own.numbers[step]): step for step in reversed(range(len(exists))) if exists[step, c]}
        shown |= {int(own.numbers[step]): step for step in reversed(within) if exists[step, c]}
        for number in dict.fromkeys(own.numbers[within.start : within.stop].tolist()):
            stem = own.stems[number] if own.stems is not None else f"{number:06d}"
            step = shown.get(number, within.start)
            plan.setdefault(step, {})[c] = folder / camera.name / f"{stem}.png"
    return dict(sorted(plan.items()))


def _chunks(steps: list[int]) -> list[list[int]]:
    """Return sorted time steps in parts of at most `CHUNK` consecutive ones."""
    parts = np.split(np.array(steps), np.flatnonzero(np.diff(steps) > 1) + 1)
    return [part[at : at + CHUNK].tolist() for part in parts for at in range(0, len(part), CHUNK)]


def _claim(capture: FileCapture, folder: Path, clean_plate: Path | None, people: bool) -> dict[str, Any]:
    """Return the record of a folder of masks. Write it if the folder is new.

    Raises:
        CaptureError: The folder holds something else.
    """
    described = capture.describe()
    facts = {name: described[name] for name in ("name", "frames", "size", "cameras", "fingerprint")}
    made = {"version": VERSION, "undistorted": True, "doubts": True, **facts, "clean_plate": clean_plate is not None}
    sweep(folder)
    record = read_mask_record(folder)
    if record is None:
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise CaptureError(f"{folder}: exists already and holds no masks of `capture masks`. Name a new folder.")
        folder.mkdir(parents=True, exist_ok=True)
        record = made | {"people": people}
        _write_record(folder, record)
    for name, value in made.items():
        if record.get(name) != value:
            raise CaptureError(
                f"{folder}: holds masks of another capture or other options: {name} is {record.get(name)!r} there and {value!r} now. "
                f"Name a new folder, or delete this one."
            )
    for camera in capture.cameras:
        (folder / camera.name).mkdir(exist_ok=True)
        sweep(folder / camera.name)
    return {"people": False} | record


def _model(
    capture: FileCapture, folder: Path, clean_plate: Path | None, progress: Progress, people: People | None
) -> tuple[SubjectModel, list[str]]:
    """Return the model of the subject, that of an interrupted call or a new one, and sentences about clean plates."""
    near = capture.near or 0.0
    if (known := _kept_model(capture, folder / MODEL, near, people)) is not None:
        return known
    names = [camera.name for camera in capture.cameras]
    # Somebody who hardly moves within the frame range often leaves their place before or after it.
    moments = sample_moments(capture.source.frames)
    progress.stage("sampling frames for the backgrounds", len(moments))
    samples, there = [], []
    for done, moment in enumerate(moments, 1):
        samples.append(capture.read_any(moment, 1, names)[0])
        there.append(_existing(capture, moment, 1)[0])
        progress.update(done)
    film, exist = np.stack(samples), np.stack(there)
    exist |= ~exist.any(0)  # a camera without an image at any of these moments
    plates, notes = None, list[str]()
    if clean_plate is not None:
        plates, notes = fitting_plates(names, read_clean_plates(clean_plate, capture), film, exist)
    progress.stage("finding the backgrounds", FIT_STEPS)
    model = fit_subject(capture.cameras, film, plates, near, progress.update, exist, people)
    if max(model.moving_shares) < FAINTEST:
        has_plates = plates is not None and any(plate is not None for plate in plates)
        doubts = "".join(f" {note}." for note in notes)
        raise CaptureError(f"{capture.path}: {NOTHING_DIFFERS if has_plates else NOTHING_MOVES}{doubts}")
    data = io.BytesIO()
    np.savez(data, notes=np.array(notes, str), **model.pack())  # type: ignore[arg-type]  # numpy's stub takes no **dict
    write_bytes(folder / MODEL, data.getvalue())
    return model, notes


def sample_moments(frames: int) -> list[int]:
    """Return the time steps, spread over a video of `frames` time steps, from which backgrounds are learned."""
    return np.unique(np.linspace(0, frames - 1, min(SAMPLES, frames)).round().astype(int)).tolist()


def _kept_model(
    capture: FileCapture, file: Path, near: float, people: People | None
) -> tuple[SubjectModel, list[str]] | None:
    """Return the model that an interrupted call left, and its sentences, if they can be read."""
    try:
        check_regular(file, CaptureError)
        with np.load(file) as arrays:
            return SubjectModel.unpack(capture.cameras, dict(arrays), near, people), arrays["notes"].tolist()
    except (OSError, ValueError, KeyError, BadZipFile, CaptureError):
        return None


def _standing(names: list[str], model: SubjectModel) -> list[str]:
    found = [
        f"{name} ({share:.1%} of its image)"
        for name, share in zip(names, model.never_uncovered, strict=True)
        if share > STANDING
    ]
    if not found:
        return []
    return [
        f"somebody seems to cover the background all the time in {', '.join(found)}. Masks may have holes there: film the scene "
        f"without people, and give these images or videos with --clean-plate FOLDER"
    ]


def _save(file: Path, mask: np.ndarray) -> None:
    write_bytes(file, encode_image(mask, ".png"))


def _shares(file: Path) -> tuple[float, float]:
    """Return the shares of the subject and of gray, which is in doubt, in a mask."""
    with Image.open(LOCAL.source(file)) as image:
        mask = np.asarray(image.convert("L"))
    return float((mask > 127).mean()), float(((mask > DOUBT[0]) & (mask < DOUBT[1])).mean())


def _disagreeing(names: list[str], shares: np.ndarray, doubtful: np.ndarray) -> list[str]:
    """Return a sentence about cameras whose image and the other views contradict each other."""
    found = [
        f"{name} ({doubt / share:.0%} of the subject's area)"
        for name, share, doubt in zip(names, shares, doubtful, strict=True)
        if doubt > DISAGREEING * share > 0
    ]
    if not found:
        return []
    return [
        f"in {', '.join(found)}, the image and the other views disagree about gray pixels. Look at these masks, and paint the gray "
        f"white or black"
    ]


def _write_record(folder: Path, record: dict[str, Any]) -> None:
    write_bytes(folder / RECORD, (json.dumps(record, indent=1) + "\n").encode())
