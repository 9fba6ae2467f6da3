"""Image files to arrays of the output size."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, UnidentifiedImageError

from splatreel.errors import CaptureError


def image_size(path: Path) -> tuple[int, int]:
    """(width, height) of an image file, without decoding it."""
    try:
        with Image.open(path) as image:
            return image.size
    except (OSError, UnidentifiedImageError) as error:
        raise CaptureError(
            f"{path}: cannot be read as an image ({error}). Replace the file or leave it out."
        ) from error


def read_image(path: Path, width: int, height: int) -> np.ndarray:
    """An image file resized to width x height by area, uint8 [height, width, 3] sRGB."""
    try:
        with Image.open(path) as image:
            return resize(image.convert("RGB"), width, height)
    except (OSError, UnidentifiedImageError, Image.DecompressionBombError) as error:
        raise CaptureError(
            f"{path}: cannot be read as an image ({error}). Replace the file or leave it out."
        ) from error


def resize(image: Image.Image, width: int, height: int) -> np.ndarray:
    """Resampled with a filter as wide as an output pixel.

    At whole ratios that is the mean over the pixel's area. Pillow's box filter takes input pixels whole, which shifts edges
    by up to half of one at other ratios, so those use the smooth window nearest to it.
    """
    if image.size != (width, height):
        whole = image.width % width == 0 and image.height % height == 0
        image = image.resize((width, height), Image.Resampling.BOX if whole else Image.Resampling.HAMMING)
    return np.asarray(image)
