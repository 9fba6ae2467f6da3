"""Median images of static cameras, which show the scene without what moves, and the pixels that differ from them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from splatreel.capture.base import Capture

MOST_FRAMES = 20
"""Maximum number of frames for the median."""
THRESHOLD = 8 / 255
"""Mean absolute difference of the channels, 0..1, from the camera's median image, above which a pixel moves."""


def median_images(capture: Capture, names: Sequence[str], most: int = MOST_FRAMES) -> list[np.ndarray]:
    """Return the median of each named camera over the capture's frames, uint8 [H, W, 3].

    One camera's frames are in memory at a time.

    Args:
        capture: The capture.
        names: Names of the cameras.
        most: Maximum number of frames, evenly spread; of an even number the lower middle is used.
    """
    times = np.linspace(0, capture.frames - 1, min(most, capture.frames)).round().astype(int)
    middle = (len(times) - 1) // 2
    images = []
    for name in names:
        stack = np.stack([capture.read(int(time), 1, [name])[0, 0] for time in times])
        stack.partition(middle, axis=0)
        images.append(stack[middle].copy())
    return images


def moving_pixels(truth: np.ndarray, median: np.ndarray) -> np.ndarray:
    """Return the pixels where an image, float32 [H, W, 3] 0..1, differs from its camera's median, uint8 [H, W, 3], as [H, W] bool."""
    return np.abs(truth - median.astype(np.float32) / 255).mean(-1) > THRESHOLD
