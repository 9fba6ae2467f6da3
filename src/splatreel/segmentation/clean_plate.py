"""Clean plates: images without the subject, as an image, a folder of images or a video for each camera."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from splatreel.base.command_line import option, quoted
from splatreel.base.errors import CaptureError
from splatreel.capture.camera_images import same_shape
from splatreel.capture.file_capture import FileCapture
from splatreel.capture.files import list_folder
from splatreel.capture.image_sequences import IMAGE_SUFFIXES, image_files
from splatreel.capture.images import image_size, read_image
from splatreel.capture.mask_files import VIDEO_SUFFIXES
from splatreel.capture.video import VideoFile

MOST = 30
"""Number of frames of a video or images of a folder that are read."""
FOLDERS = ("", "videos", "images", "ims")
"""Folders of a capture that hold the files of its cameras."""


def read_clean_plates(folder: Path, capture: FileCapture) -> list[np.ndarray]:
    """Return images without the subject for each camera, [P, H, W, 3] uint8 each, undistorted and at the size of the capture.

    Args:
        folder: Folder with an image, a folder of images or a video of each camera's name. Another take without the subject is
            such a folder.
        capture: The capture.

    Raises:
        CaptureError: A camera has no clean plate, or it has another shape than the camera's images.
    """
    if not folder.is_dir():
        raise CaptureError(
            f"{folder}: is not a folder. Give --clean-plate a folder with an image or a video for each camera."
        )
    return [_of_camera(folder, camera.name, capture) for camera in capture.cameras]


def _of_camera(folder: Path, name: str, capture: FileCapture) -> np.ndarray:
    place = _place(folder, name)
    video = VideoFile(place) if place.suffix.lower() in VIDEO_SUFFIXES and place.is_file() else None
    images = [] if video else [place] if place.is_file() else image_files(place)
    if video is None and not images:
        raise CaptureError(f"{place}: holds no images. Copy the clean plate of camera {name} there.")
    size = (video.width, video.height) if video else image_size(images[0])
    expected = capture.source.size(name)
    if not same_shape(size, expected):
        raise CaptureError(
            f"{place}: is {size[0]}x{size[1]}, but the images of camera {name} are {expected[0]}x{expected[1]}. Film the clean plate "
            f"with the same settings of the camera."
        )
    count = video.frames if video else len(images)
    numbers = np.unique(np.linspace(0, count - 1, min(count, MOST)).round().astype(int))

    def read(out: np.ndarray, first: int, name: str) -> None:
        if video:
            video.read_into(out, numbers)
        else:
            for image, number in zip(out, numbers, strict=True):
                image[:] = read_image(images[number], out.shape[2], out.shape[1], size=size)

    out = np.empty((len(numbers), capture.height, capture.width, 3), np.uint8)
    try:
        capture.read_undistorted(read, out, 0, name)
    finally:
        if video:
            video.close()
    return out


def _place(folder: Path, name: str) -> Path:
    """Return the image, video or folder of a camera."""
    kinds = (*VIDEO_SUFFIXES, *IMAGE_SUFFIXES)
    for inner in FOLDERS:
        if not (folder / inner).is_dir():
            continue
        if (folder / inner / name).is_dir():
            own = folder / inner / name
            return own / "images" if not image_files(own) and (own / "images").is_dir() else own
        found = [file for file in list_folder(folder / inner) if file.stem == name and file.suffix.lower() in kinds]
        if len(found) > 1:
            raise CaptureError(
                f"{folder}: both {found[0].name} and {found[1].name} are clean plates of camera {name}. Remove one."
            )
        if found:
            return found[0]
    raise CaptureError(
        f"{folder}: there is no clean plate of camera {name}. Add an image {name}.png without the subject, or leave the camera out "
        f"with {quoted(option('--leave-out', name))}."
    )
