"""Where the pictures of a group change: what moves is nowhere else."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np

from splatreel import threads
from splatreel.capture.frame_file import release_pages

MIN_DIFFERENCE = 8 / 255
"""Mean absolute difference of the colors around a pixel, 0..1, from which on it counts as changed."""
NOISE = 2.5
"""... and in multiples of what a quarter of the camera's pixels stay below: noise, compression, lamps that flicker."""


MEAN_OF_COLORS = np.full((1, 3), 1 / (3 * 255), np.float32)
"""And from 0..255 to 0..1. OpenCV's pass takes a quarter of the time of NumPy's mean over an axis of three."""


def difference(frame: np.ndarray, first: np.ndarray) -> np.ndarray:
    """[H, W] float32, 0..1: how far a picture is from another around each pixel, [H, W, 3] uint8 and float32 of 0..255.

    Noise mostly cancels.
    """
    apart = cv2.GaussianBlur(cv2.subtract(frame, first, dtype=cv2.CV_32F), (5, 5), 0)
    return cv2.transform(np.abs(apart, out=apart), MEAN_OF_COLORS)


def changes(frames: np.ndarray) -> np.ndarray:
    """[C, H, W] bool: where a camera's picture is at some frame not what it was at the first. frames: [T, C, H, W, 3] uint8."""

    def of(camera: int) -> np.ndarray:
        found = _changes(frames[:, camera])
        release_pages(frames)
        return found

    with ThreadPoolExecutor(threads.count()) as pool:
        return np.stack(list(pool.map(of, range(frames.shape[1]))))


def _changes(frames: np.ndarray) -> np.ndarray:
    """The same of one camera: [T, H, W, 3] to [H, W]."""
    first = frames[0].astype(np.float32)
    peak = np.zeros(first.shape[:2], np.float32)
    for frame in frames[1:]:
        np.maximum(peak, difference(frame, first), out=peak)
    return peak > max(MIN_DIFFERENCE, NOISE * float(np.quantile(peak, 0.25)))
