"""Clean plates: images without the subject, as an image, a folder of images or a video for each camera."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from splatreel.base.command_line import option, quoted
from splatreel.base.errors import CaptureError
from splatreel.capture.file_capture import FileCapture
from splatreel.capture.files import list_folder
from splatreel.capture.image_sequences import IMAGE_SUFFIXES, image_files
from splatreel.capture.images import image_size, read_image, same_shape
from splatreel.capture.masks import VIDEO_SUFFIXES
from splatreel.capture.video import VideoFile

MOST = 30
"""Number of frames of a video or images of a folder that are read."""
FOLDERS = ("", "videos", "images", "ims")
"""Folders of a capture that hold the files of its cameras."""

SAME, LEAD = 0.6, 0.15
"""Smallest correlation of the details of a plate and of the images of its camera, and by how much more it resembles another's."""
SAME_LIGHT = 0.25
"""Largest logarithm of the brightness of a plate relative to the images."""
TYPICAL, COMPARED, PARTS = 12, 160, 6
"""Number of samples whose median is compared, width in pixels, and number of parts of the image along each side."""


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


def fitting_plates(
    names: Sequence[str], plates: Sequence[np.ndarray], samples: np.ndarray, there: np.ndarray
) -> tuple[list[np.ndarray | None], list[str]]:
    """Return the clean plates that show what their cameras show, None for others, and sentences about the others.

    Args:
        names: Names of the cameras.
        plates: [P, H, W, 3] uint8 of each camera.
        samples: [S, C, H, W, 3] uint8, moments spread over the video.
        there: [S, C] bool, the samples that exist.
    """
    films = [film[exist] for film, exist in zip(samples.swapaxes(0, 1), there.T, strict=True)]
    typical = [np.median(film[:: max(len(film) // TYPICAL, 1)], 0).astype(np.float32) for film in films]
    structures = [_structure(image) for image in typical]
    found, notes = list[np.ndarray | None](plates), []
    for c, (name, plate) in enumerate(zip(names, plates, strict=True)):
        empty = np.median(plate, 0).astype(np.float32)
        alike = [_alike(_structure(empty), structure) for structure in structures]
        best = int(np.argmax(alike))
        light = min((_light(empty, sample) for sample in films[c]), key=abs)
        reason = ""
        if alike[c] < SAME and best != c and alike[best] > max(SAME, alike[c] + LEAD):
            reason = f"shows what camera {names[best]} shows"
        elif alike[c] < SAME:
            reason = "does not show what the camera shows: another zoom or place, or the camera was moved"
        elif abs(light) > SAME_LIGHT:
            reason = f"has another light, {np.exp(light):.2g} times as bright as the images"
        if reason:
            found[c] = None
            notes.append(
                f"the clean plate of {name} {reason}. It is not used: film it with the same settings and the same light as the capture"
            )
    return found, notes


def _structure(image: np.ndarray) -> np.ndarray:
    """Return the details of an image [H, W, 3] float32 relative to their surroundings, [H, W], in a width of `COMPARED` pixels."""
    width = min(COMPARED, image.shape[1])
    small = cv2.resize(
        image.mean(-1), (width, round(image.shape[0] * width / image.shape[1])), interpolation=cv2.INTER_AREA
    )
    level = np.log(np.maximum(small, 8))
    return cv2.GaussianBlur(level, (0, 0), 0.7) - cv2.GaussianBlur(level, (0, 0), 0.08 * width)


def _alike(one: np.ndarray, other: np.ndarray) -> float:
    """Return how alike two images are by their details, -1..1: median correlation of the parts of the image that have details."""
    parts = [
        (np.array_split(row, PARTS, 1), np.array_split(second, PARTS, 1))
        for row, second in zip(np.array_split(one, PARTS, 0), np.array_split(other, PARTS, 0), strict=True)
    ]
    found, weights = [], []
    for a, b in ((a, b) for row, second in parts for a, b in zip(row, second, strict=True)):
        product, size = float((a * b).mean()), float(np.sqrt((a * a).mean() * (b * b).mean()))
        found.append(product / max(size, 1e-9))
        weights.append(size)
    detailed = np.array(weights) > 0.25 * max(weights)
    return float(np.median(np.array(found)[detailed]))


def _light(plate: np.ndarray, image: np.ndarray) -> float:
    return float(np.median(np.log(np.maximum(plate.mean(-1), 4)) - np.log(np.maximum(image.mean(-1), 4))))


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
