"""Pictures to judge a result by eye: truth | render | error."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from splatreel.scene.atomic import replacing

ERROR_GAIN = 4
"""The error is shown four times as bright: 1/4 of the range is white."""


def comparison(truth: np.ndarray, render: np.ndarray) -> np.ndarray:
    """Truth, render and amplified absolute error side by side. Two float images [H, W, 3] 0..1 -> uint8 [H, 3 W, 3]."""
    error = np.abs(truth - render) * ERROR_GAIN
    strip = np.concatenate([truth, render, error], axis=1)
    return (np.clip(strip, 0, 1) * 255 + 0.5).astype(np.uint8)


def write_png(path: Path, image: np.ndarray) -> None:
    """Write a uint8 [H, W, 3] image, at once."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        Image.fromarray(image).save(temporary, format="PNG")
