"""Rendered pictures as JPEG."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np
from PIL import Image

QUALITIES = (80, 70, 60, 50, 40, 30)


def jpeg_within(pixels: np.ndarray, most: int, qualities: Sequence[int] = QUALITIES) -> bytes:
    """[H, W, 3] uint8 as a progressive JPEG in the best quality that takes at most so many bytes, or else in the last."""
    data = b""
    for quality in qualities:
        file = io.BytesIO()
        Image.fromarray(pixels).save(file, "JPEG", quality=quality, progressive=True, optimize=True)
        data = file.getvalue()
        if len(data) <= most:
            break
    return data


def to_bytes(image: np.ndarray) -> np.ndarray:
    """Colors from 0 to 1, which may exceed it, as uint8."""
    return np.rint(np.clip(image, 0, 1) * 255).astype(np.uint8)
