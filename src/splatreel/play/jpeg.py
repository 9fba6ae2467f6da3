"""JPEG encoding of rendered images."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np
from PIL import Image

QUALITIES = (80, 70, 60, 50, 40, 30)


def jpeg_within(pixels: np.ndarray, most: int, qualities: Sequence[int] = QUALITIES) -> bytes:
    """Encode pixels as a progressive JPEG of bounded size.

    Args:
        pixels: [H, W, 3] uint8.
        most: Maximum number of bytes. If no quality fits, the last one is used.
        qualities: Qualities to try, best first.
    """
    data = b""
    for quality in qualities:
        file = io.BytesIO()
        Image.fromarray(pixels).save(file, "JPEG", quality=quality, progressive=True, optimize=True)
        data = file.getvalue()
        if len(data) <= most:
            break
    return data


def to_bytes(image: np.ndarray) -> np.ndarray:
    """Convert colors from float to uint8, clipped to 0..1."""
    return np.rint(np.clip(image, 0, 1) * 255).astype(np.uint8)
