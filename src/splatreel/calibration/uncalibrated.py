"""Folders of synchronized videos or images whose cameras are not known yet."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from splatreel.base.errors import CaptureError
from splatreel.capture.base import MIN_CAMERAS, Request
from splatreel.capture.file_capture import FrameSource
from splatreel.capture.image_sequences import flat_images, image_source
from splatreel.capture.readers.colmap import camera_folders, is_colmap, unread_videos, videos_but
from splatreel.capture.readers.neu3dv import POSES
from splatreel.capture.sidecar import read_sidecar
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
