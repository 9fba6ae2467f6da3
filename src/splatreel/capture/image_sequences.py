"""Image files, one per camera and time step."""

from __future__ import annotations

import math
import re
from itertools import pairwise
from pathlib import Path

import numpy as np

from splatreel.capture.base import Request
from splatreel.capture.frame_table import FrameTable
from splatreel.capture.growing.growth import is_recorded
from splatreel.capture.images import image_size, read_image
from splatreel.capture.sidecar import SIDECAR, Sidecar
from splatreel.capture.soundtrack import Track
from splatreel.errors import CaptureError

IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff", ".bmp")


class ImageSequences:
    """Image files of a capture by camera in order of time. All cameras start together.

    Attributes:
        frames: Number of time steps that all cameras have.
        fps: Frame rate of the sidecar, or 30.

    Raises:
        CaptureError: The cameras have different numbers of images and no frames were requested, or the sidecar has
            start times.
    """

    def __init__(self, path: Path, files: dict[str, list[Path]], sidecar: Sidecar, request: Request) -> None:
        self._files, self._where = files, request.files
        self.fps = sidecar.fps or 30.0
        if sidecar.starts:
            raise CaptureError(
                f"{path / SIDECAR}: has start times of videos, but the cameras have images. Remove `starts`."
            )
        counts = {name: len(found) for name, found in files.items()}
        self.frames = min(counts.values(), default=0)
        if request.frames is None and not is_recorded(path) and len(set(counts.values())) > 1:
            low, high = min(counts, key=lambda n: counts[n]), max(counts, key=lambda n: counts[n])
            raise CaptureError(
                f"{path}: the cameras have unequal numbers of pictures: {low} has {counts[low]}, {high} has {counts[high]}. Add "
                f"those that are missing, or, if all start together, choose the frames all of them have: --frames 0:{counts[low]}."
            )

    def size(self, name: str) -> tuple[int, int]:
        """Return width and height of a camera's first image."""
        return image_size(self._files[name][0], self._where)

    def read_camera(self, out: np.ndarray, first: int, name: str) -> None:
        """Read time steps from `first` on of a camera into out [count, H, W, 3] uint8."""
        for picture, file in zip(out, self._files[name][first : first + len(out)], strict=True):
            picture[:] = read_image(file, out.shape[2], out.shape[1], self._where)

    def sources(self, first: int, count: int) -> list[Path]:
        """Return the files that are read."""
        return [file for files in self._files.values() for file in files[first : first + count]]

    def tables(self) -> dict[Path, FrameTable]:
        """Return nothing, because images have no frame tables."""
        return {}

    def tracks(self, first: int) -> dict[str, Track]:
        """Return nothing, because images have no sound."""
        return {}

    def close(self) -> None:
        """Do nothing, because no files stay open."""


def image_files(folder: Path) -> list[Path]:
    """Return the image files in a folder, sorted by name."""
    return sorted(file for file in folder.glob("*") if file.suffix.lower() in IMAGE_SUFFIXES)


def in_order(files: list[Path], request: Request) -> list[Path]:
    """Return the images of a camera in order of the numbers at the ends of their names; without numbers, in order of names.

    Raises:
        CaptureError: A number is missing or occurs twice among the requested frames, see `refuse_gaps`.
    """
    found = [re.fullmatch(r"(.*?)(\d+)", file.stem) for file in files]
    named = {match[1]: match for match in found if match}
    if None in found or len(named) > 1:
        return files
    numbers = {file: int(match[2]) for file, match in zip(files, found, strict=True) if match}
    ordered = sorted(files, key=numbers.__getitem__)
    refuse_gaps(ordered, [numbers[file] for file in ordered], request)
    return ordered


def refuse_gaps(files: list[Path], numbers: list[int], request: Request) -> None:
    """Raise `CaptureError` if frames are missing among those that are requested. A constant step between numbers is no gap.

    Args:
        files: Images in order.
        numbers: Their ascending numbers.
        request: Options of the capture.
    """
    end = len(numbers) if request.frames is None else request.frames[1]
    steps = [after - before for before, after in pairwise(numbers[:end])]
    if 0 in steps:
        raise CaptureError(
            f"{files[steps.index(0)]}: frame {numbers[steps.index(0)]} is there twice. Remove one of them."
        )
    step = math.gcd(*steps)
    gap = next((index for index, size in enumerate(steps) if size > step), None)
    if gap is not None:
        raise CaptureError(
            f"{files[gap].parent}: pictures are missing after {files[gap].name}: the next one is {files[gap + 1].name}. Later frames "
            f"would be shown too early. Add the pictures, or choose the frames before: --frames 0:{gap + 1}."
        )
