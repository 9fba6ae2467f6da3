"""Where something moves in a picture: what the same camera does not show most of the time."""

from __future__ import annotations

import numpy as np

from splatreel.capture.base import Capture

THRESHOLD = 8 / 255
"""Mean absolute difference of the channels, 0..1, from the camera's median picture."""
MOST_FRAMES = 20
"""Frames that the median is taken of."""


def median_pictures(capture: Capture, names: list[str]) -> list[np.ndarray]:
    """The median over the capture's frames of each named camera, uint8 [H, W, 3].

    At most 20 frames, spread evenly over all; of an even number the lower middle. One camera's frames are held at a time. Raises
    what reading the capture raises.
    """
    times = np.linspace(0, capture.frames - 1, min(MOST_FRAMES, capture.frames)).round().astype(int)
    middle = (len(times) - 1) // 2
    pictures = []
    for name in names:
        stack = np.stack([capture.read(int(time), 1, [name])[0, 0] for time in times])
        stack.partition(middle, axis=0)
        pictures.append(stack[middle].copy())
    return pictures


def moving_pixels(truth: np.ndarray, median: np.ndarray) -> np.ndarray:
    """[H, W] bool: where a picture, float32 [H, W, 3] 0..1, is not as its camera's median picture, uint8 [H, W, 3]."""
    return np.abs(truth - median.astype(np.float32) / 255).mean(-1) > THRESHOLD
