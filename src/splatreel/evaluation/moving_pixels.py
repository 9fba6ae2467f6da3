"""Pixels with motion: those that differ from the median image of their static camera."""

from __future__ import annotations

import numpy as np

THRESHOLD = 8 / 255
"""Mean absolute difference of the channels, 0..1, from the camera's median image, above which a pixel moves."""


def moving_pixels(truth: np.ndarray, median: np.ndarray) -> np.ndarray:
    """Return the pixels where an image, float32 [H, W, 3] 0..1, differs from its camera's median, uint8 [H, W, 3], as [H, W] bool."""
    return np.abs(truth - median.astype(np.float32) / 255).mean(-1) > THRESHOLD
