"""Reading of image files at the output size."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np
from av.video.reformatter import Interpolation
from PIL import Image, UnidentifiedImageError

from splatreel.capture.files import LOCAL, Files
from splatreel.errors import CaptureError


def image_size(path: Path, files: Files = LOCAL) -> tuple[int, int]:
    """Return width and height of an image file without decoding it."""
    try:
        with Image.open(files.source(path)) as image:
            return image.size
    except (OSError, UnidentifiedImageError) as error:
        raise _unreadable(path, error) from error


def read_image(path: Path, width: int, height: int, files: Files = LOCAL) -> np.ndarray:
    """Return an image resized by area to width x height, uint8 [height, width, 3] sRGB."""
    try:
        with Image.open(files.source(path)) as image:
            pixels = np.asarray(image.convert("RGB"))
    except (OSError, UnidentifiedImageError, Image.DecompressionBombError) as error:
        raise _unreadable(path, error) from error
    if pixels.shape[:2] == (height, width):
        return pixels
    frame = av.VideoFrame.from_ndarray(pixels, format="rgb24")  # resample as videos are
    return frame.reformat(width, height, "rgb24", interpolation=Interpolation.AREA).to_ndarray()


def _unreadable(path: Path, error: Exception) -> CaptureError:
    if not path.exists():
        return CaptureError(f"{path}: is missing, though the capture's description names it. Copy it there.")
    return CaptureError(f"{path}: cannot be read as an image ({error}). Replace the file or leave it out.")
