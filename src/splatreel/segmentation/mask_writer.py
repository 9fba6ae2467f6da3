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
from splatreel.base.atomic import remove, write_bytes
from splatreel.base.errors import CaptureError
from splatreel.base.progress import Progress
from splatreel.capture.file_capture import FileCapture
from splatreel.capture.images import encode_image
from splatreel.capture.mask_files import RECORD, read_mask_record
from splatreel.capture.own_frames import CountedSource
from splatreel.method.layering.masks import Segmenter
from splatreel.segmentation.clean_plate import read_clean_plates
from splatreel.segmentation.segmenter import FIT_STEPS, SubjectModel, fit_subject

SAMPLES = 30
"""Number of moments, spread over the video, from which backgrounds are learned."""
CHUNK = 8
"""Number of moments that are read at a time."""
STANDING = 0.0005
"""Share of an image that somebody who never moves must cover to be reported."""
FAINTEST = 0.0005
"""Smallest share of the images that a subject covers, at least in one camera and moment."""
VERSION = 4
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
) -> WrittenMasks:
    """Write a mask for each frame and camera of a capture: FOLDER/CAMERA/NAME.png, named as the camera's own images.

    Images that exist are kept, so masks that were corrected by hand stay.

    Args:
        capture: The capture, at the size at which masks are made.
        folder: Folder of the masks. It is new, empty, or holds masks of the same capture.
        progress: Progress display.
        clean_plate: Folder with images without the subject; None finds backgrounds in the capture itself.
        segmenter: Network that completes the masks of each moment.

    Raises:
        CaptureError: The capture is still growing, nothing moves, or the folder belongs to another capture.
    """
    source = capture.source
    if capture.growing or not isinstance(source, CountedSource):
        raise CaptureError(f"{capture.path}: is still being written. Make masks when the capture is complete.")
    files = _files(capture, source, folder)
    record = _claim(capture, folder, clean_plate)
    wanted = [[not file.exists() for file in moment] for moment in files]
    if record.get("complete") and not any(map(any, wanted)):
        return WrittenMasks(0, record["shares"], record["notes"])
    model = _model(capture, folder, clean_plate, progress)
    names = [camera.name for camera in capture.cameras]
    notes = _standing(names, model)
    written, total = 0, np.zeros(len(names))
    progress.stage("writing masks", capture.frames)
    for first in range(0, capture.frames, CHUNK):
        count = min(CHUNK, capture.frames - first)
        if any(map(any, wanted[first : first + count])):
            before, after = min(first, 1), min(capture.frames - first - count, 1)
            frames = capture.read(first - before, before + count + after, names)
            masks = model.masks(frames)[before : before + count]
            if segmenter is not None:
                pairs = zip(masks, frames[before : before + count], strict=True)
                completed = np.stack([segmenter.complete(mask > 127, images) for mask, images in pairs])
                masks = np.where(completed, np.uint8(255), np.uint8(0))
            for moment, missing, shown in zip(files[first:], wanted[first:], masks, strict=False):
                jobs = [(file, mask) for file, new, mask in zip(moment, missing, shown, strict=True) if new]
                threads.map_parallel(lambda job: _save(*job), jobs)
                written += len(jobs)
        total += [sum(_share(file[c]) for file in files[first : first + count]) for c in range(len(names))]
        progress.update(first + count)
    shares = dict(zip(names, (total / capture.frames).tolist(), strict=True))
    if unseen := [name for name, share in shares.items() if share == 0]:
        notes.append(f"no subject is seen by {', '.join(unseen)}")
    _write_record(folder, record | {"complete": True, "shares": shares, "notes": notes})
    remove(folder / MODEL)
    return WrittenMasks(written, shares, notes)


def _files(capture: FileCapture, source: CountedSource, folder: Path) -> list[list[Path]]:
    """Return the file of each moment and camera."""
    columns = []
    for camera in capture.cameras:
        own = source.own_frames(camera.name)
        numbers = own.numbers[capture.first_frame : capture.first_frame + capture.frames]
        stems = [own.stems[number] if own.stems is not None else f"{number:06d}" for number in numbers]
        columns.append([folder / camera.name / f"{stem}.png" for stem in stems])
    return [list(row) for row in zip(*columns, strict=True)]


def _claim(capture: FileCapture, folder: Path, clean_plate: Path | None) -> dict[str, Any]:
    """Return the record of a folder of masks. Write it if the folder is new.

    Raises:
        CaptureError: The folder holds something else.
    """
    described = capture.describe()
    facts = {name: described[name] for name in ("name", "frames", "size", "cameras", "fingerprint")}
    made = {"version": VERSION, "undistorted": True, "doubts": True, **facts, "clean_plate": clean_plate is not None}
    record = read_mask_record(folder)
    if record is None:
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise CaptureError(f"{folder}: exists already and holds no masks of `capture masks`. Name a new folder.")
        folder.mkdir(parents=True, exist_ok=True)
        _write_record(folder, made)
        record = made
    for name, value in made.items():
        if record.get(name) != value:
            raise CaptureError(
                f"{folder}: holds masks of another capture or other options: {name} is {record.get(name)!r} there and {value!r} now. "
                f"Name a new folder, or delete this one."
            )
    for camera in capture.cameras:
        (folder / camera.name).mkdir(exist_ok=True)
    return record


def _model(capture: FileCapture, folder: Path, clean_plate: Path | None, progress: Progress) -> SubjectModel:
    """Return the model of the subject: that of an interrupted call, or a new one."""
    near = capture.near or 0.0
    if (known := _kept_model(capture, folder / MODEL, near)) is not None:
        return known
    names = [camera.name for camera in capture.cameras]
    # Somebody who hardly moves within the frame range often leaves their place before or after it.
    moments = sample_moments(capture.source.frames)
    progress.stage("sampling frames for the backgrounds", len(moments))
    samples = []
    for done, moment in enumerate(moments, 1):
        samples.append(capture.read_any(moment, names))
        progress.update(done)
    plates = None if clean_plate is None else read_clean_plates(clean_plate, capture)
    progress.stage("finding the backgrounds", FIT_STEPS)
    model = fit_subject(capture.cameras, np.stack(samples), plates, near, progress.update)
    if max(model.moving_shares) < FAINTEST:
        raise CaptureError(f"{capture.path}: {NOTHING_MOVES if clean_plate is None else NOTHING_DIFFERS}")
    data = io.BytesIO()
    np.savez(data, **model.pack())  # type: ignore[arg-type]  # numpy's stub takes no **dict
    write_bytes(folder / MODEL, data.getvalue())
    return model


def sample_moments(frames: int) -> list[int]:
    """Return the time steps, spread over a video of `frames` time steps, from which backgrounds are learned."""
    return np.unique(np.linspace(0, frames - 1, min(SAMPLES, frames)).round().astype(int)).tolist()


def _kept_model(capture: FileCapture, file: Path, near: float) -> SubjectModel | None:
    """Return the model that an interrupted call left, if it can be read."""
    try:
        with np.load(file) as arrays:
            return SubjectModel.unpack(capture.cameras, dict(arrays), near)
    except (OSError, ValueError, KeyError, BadZipFile):
        return None


def _standing(names: list[str], model: SubjectModel) -> list[str]:
    """Return a sentence about people who cover the background all the time."""
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


def _share(file: Path) -> float:
    """Return the share of white in a mask."""
    with Image.open(file) as image:
        return float((np.asarray(image.convert("L")) > 127).mean())


def _write_record(folder: Path, record: dict[str, Any]) -> None:
    write_bytes(folder / RECORD, (json.dumps(record, indent=1) + "\n").encode())
