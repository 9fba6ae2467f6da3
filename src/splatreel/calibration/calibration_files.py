"""Files of a calibration: the videos and images of cameras without poses, photographs, and the record of the command."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from splatreel.base.errors import CaptureError, SplatreelError
from splatreel.base.progress import Progress
from splatreel.base.untrusted import read_file, read_json
from splatreel.capture.base import MIN_CAMERAS, Request
from splatreel.capture.file_capture import FrameSource
from splatreel.capture.image_sequences import IMAGE_SUFFIXES, flat_images, image_files, image_source
from splatreel.capture.images import encode_image, image_size, read_whole_image
from splatreel.capture.readers.colmap import camera_folders, is_colmap, unread_videos, videos_but
from splatreel.capture.readers.neu3dv import POSES
from splatreel.capture.sidecar import read_sidecar
from splatreel.capture.video import VIDEO_SUFFIXES
from splatreel.capture.videos import Videos

MODEL = Path("sparse/0")
"""Place of the model that a calibration writes."""

CameraFiles = dict[str, Path | list[Path]]
"""Video, or images in order, by camera."""


def uncalibrated_files(path: Path, leave_out: Sequence[str]) -> CameraFiles:
    """Return the videos of a folder, or the images of its folders, by camera, without some cameras.

    Raises:
        CaptureError: The folder is calibrated already, has too few cameras, or lacks one that is left out.
    """
    if is_colmap(path) or (path / POSES).exists():
        raise CaptureError(f"{path}: is calibrated already. Delete {MODEL.parent} or {POSES} to calibrate it again.")
    files = camera_files(path, leave_out)
    if len(files) < MIN_CAMERAS:
        others = "".join(f" {sentence}." for sentence in unread_videos(path))
        others += f" {flat}" if (flat := flat_images(path) or flat_images(path / "images")) else ""
        raise CaptureError(
            f"{path}: videos or folders of images of {len(files)} cameras ({', '.join(files) or 'none'}), at least {MIN_CAMERAS} are "
            f"needed. Add the others.{others}"
        )
    return files


def camera_files(path: Path, leave_out: Sequence[str]) -> CameraFiles:
    """Return the videos of a folder, or else the images of its folders, by camera, without some cameras.

    Raises:
        CaptureError: A camera that is left out does not exist.
    """
    images = camera_folders(path) or camera_folders(path / "images")
    if not images or videos_but(path, ()):
        return dict(videos_but(path, leave_out))
    if unknown := [name for name in leave_out if name not in images]:
        raise CaptureError(f"{path}: there is no camera {unknown[0]!r} to leave out; there are {', '.join(images)}.")
    return {name: files for name, files in images.items() if name not in leave_out}


def open_uncalibrated(path: Path, files: CameraFiles) -> FrameSource:
    """Return the synchronized frames of some cameras of a folder. EXIF is ignored, as in the model that is written."""
    sidecar, request = read_sidecar(path), Request(frames=(0, 1))
    sidecar = sidecar.only(files)
    images = {name: found for name, found in files.items() if isinstance(found, list)}
    if images:
        return image_source(path, images, sidecar, request, upright=False)
    videos = {name: found for name, found in files.items() if isinstance(found, Path)}
    return Videos(path, videos, sidecar, request)


def read_frame(source: FrameSource, name: str, frame: int) -> np.ndarray:
    """Return a frame of a camera, [H, W, 3] uint8."""
    width, height = source.size(name)
    image = np.empty((1, height, width, 3), np.uint8)
    source.read_camera(image, frame, name)
    return image[0]


PHOTO_FOLDER = "also/"
"""Folder of the photographs among the cameras' images, which have no folder."""
LONGEST = 2400
"""Size in pixels to which photographs are reduced. More gives COLMAP little."""


def check_photos(folder: Path) -> list[Path]:
    """Return the photographs of a folder. Raise `CaptureError` if there are none or one cannot be read."""
    if not folder.is_dir():
        raise CaptureError(f"{folder}: is not a folder. Name a folder of photographs.")
    files = image_files(folder)
    if not files:
        raise CaptureError(f"{folder}: holds no photographs (JPEG, PNG, WebP, TIFF or BMP). Copy them there.")
    for file in files:
        image_size(file)
    return files


def write_photos(files: list[Path], images: Path, progress: Progress) -> list[str]:
    """Write upright copies of photographs, grouped by size, since equal sizes share a lens. Return their names."""
    names = []
    progress.stage("reading photographs", len(files))
    for number, file in enumerate(files):
        image = Image.fromarray(read_whole_image(file))
        image.thumbnail((LONGEST, LONGEST), Image.Resampling.LANCZOS)
        name = f"{PHOTO_FOLDER}{image.width}x{image.height}/{number:05d}.jpg"
        (images / name).parent.mkdir(parents=True, exist_ok=True)
        (images / name).write_bytes(encode_image(image, ".jpg", quality=95))
        names.append(name)
        progress.update(number + 1)
    return names


def write_image(file: Path, image: np.ndarray) -> None:
    """Write a frame [H, W, 3] uint8 as a PNG file."""
    file.write_bytes(encode_image(image, file.suffix, compress_level=1))


RECORD = "calibration.json"
"""Record beside the files of COLMAP, which ignores it. A command that was killed just after it finished finds its own model by it.
The models cannot be compared, because COLMAP does not give the same one twice."""
METRIC = ("distance", "scale_board", "board")
"""Options with which the unit of a calibration is a meter."""
MODEL_BYTES = 1 << 30
"""Maximum size of a file of a model that is compared with its record."""


def calibration_record(path: Path, options: dict[str, Any], others: list[Path]) -> dict[str, Any]:
    """Return what determines a calibration: options, the start times, and the names and lengths of the files.

    Args:
        path: Folder of the capture.
        options: Options of the command.
        others: Other folders that it reads, of photographs or of videos.
    """
    sidecar = read_sidecar(path)
    lengths = [{str(file): size for file, size in _camera_files(folder)} for folder in (path, *others)]
    return {"options": options, "starts": sidecar.starts, "rates": sidecar.rates, "files": lengths}


def _camera_files(folder: Path) -> Iterator[tuple[Path, int]]:
    for file in sorted(folder.rglob("*")):
        if file.suffix.lower() in (*VIDEO_SUFFIXES, *IMAGE_SUFFIXES) and file.is_file():
            yield file.relative_to(folder), file.stat().st_size


def write_record(model: Path, record: dict[str, Any]) -> None:
    """Write the record of a model into its folder."""
    (model / RECORD).write_text(json.dumps(record | {"model": _digests(model)}, indent=1) + "\n", encoding="utf-8")


def is_made_by(path: Path, record: dict[str, Any]) -> bool:
    """Return whether a capture has a whole model that a command with the same record made."""
    model = path / MODEL
    try:
        known = read_json(model / RECORD, CaptureError)
        return isinstance(known, dict) and known == record | {"model": _digests(model)}
    except (SplatreelError, OSError):
        return False


def is_in_meters(path: Path) -> bool:
    """Return whether a capture has a whole model that `capture calibrate` made, whose unit is a meter."""
    model = path / MODEL
    try:
        known = read_json(model / RECORD, CaptureError)
        options = known.get("options") if isinstance(known, dict) else None
        return isinstance(options, dict) and any(o in options for o in METRIC) and known.get("model") == _digests(model)
    except (SplatreelError, OSError):
        return False


def _digests(model: Path) -> dict[str, str]:
    files = sorted(file for file in model.iterdir() if file.is_file() and file.name != RECORD)
    return {file.name: hashlib.sha256(read_file(file, MODEL_BYTES, CaptureError)).hexdigest() for file in files}
