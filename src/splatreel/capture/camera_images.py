"""Images of several cameras, each of one size and orientation."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from pathlib import Path

import numpy as np

from splatreel.base import threads
from splatreel.capture.files import Files
from splatreel.capture.images import ImageHeader, read_header, read_image
from splatreel.capture.orientation import STORED
from splatreel.capture.video_color import sentences


class CameraImages:
    """Images of several cameras. All images of a camera have one size.

    Args:
        first: First image of each camera.
        files: Access to the files.
        upright: True obeys EXIF as OpenCV does, False ignores it as COLMAP does.
    """

    def __init__(self, first: dict[str, Path], files: Files, upright: bool) -> None:
        self._first = first
        self._files = files
        self._upright = dict.fromkeys(first, upright)

    @cached_property
    def _headers(self) -> dict[str, ImageHeader]:
        with ThreadPoolExecutor(threads.count()) as pool:
            found = pool.map(lambda file: read_header(file, self._files), self._first.values())
            return dict(zip(self._first, found, strict=True))

    def size(self, name: str, calibrated: tuple[int, int] | None = None) -> tuple[int, int]:
        """Return width and height of a camera's images.

        Args:
            name: Name of the camera.
            calibrated: Width and height of its calibration. They decide whether EXIF is obeyed, if only one way fits.
        """
        header, upright = self._headers[name], self._upright[name]
        if calibrated is not None and not same_shape(header.shown_size(upright), calibrated):
            self._upright[name] = upright != same_shape(header.shown_size(not upright), calibrated)
        return header.shown_size(self._upright[name])

    def read(self, out: np.ndarray, name: str, file: Path) -> None:
        """Read an image of a camera into out [H, W, 3] uint8 sRGB, resized by area.

        Raises:
            CaptureError: The image cannot be read, or has another size than the camera's first one.
        """
        upright, size = self._upright[name], self.size(name)
        out[:] = read_image(file, out.shape[1], out.shape[0], self._files, upright=upright, size=size)

    def conversions(self) -> list[str]:
        """Return sentences about conversions of the images that users should know of."""
        phrases = {}
        for name, header in self._headers.items():
            turned = "turned upright as EXIF says" if self._upright[name] else "not turned as EXIF says, as in COLMAP"
            phrases[name] = [*header.conversions, *([f"images are {turned}"] if header.orientation != STORED else [])]
        return sentences(phrases)


def same_shape(size: tuple[int, int], other: tuple[int, int]) -> bool:
    """Return whether one size is the other one resized, up to a pixel of rounding in the smaller one."""
    small, large = sorted((size, other))
    narrow, wide = (small[0] - 1) * large[1], (small[0] + 1) * large[1]
    return narrow <= large[0] * (small[1] + 1) and large[0] * (small[1] - 1) <= wide
