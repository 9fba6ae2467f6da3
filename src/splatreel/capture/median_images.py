"""Median images of static cameras, which show the scene without what moves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from splatreel.capture.base import Capture

MOST_FRAMES = 20
"""Maximum number of frames for the median."""


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
