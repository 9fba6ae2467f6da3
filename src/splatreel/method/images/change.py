"""Changing pixels of a group. Content moves nowhere else."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from splatreel.base import threads
from splatreel.base.paged_arrays import release_pages

MIN_DIFFERENCE = 8 / 255
"""Minimum mean absolute color difference around a pixel, 0..1, for it to count as changed."""
NOISE_MULTIPLE = 2.5
"""The same limit in multiples of the first quartile of the camera's differences: noise, compression, flickering lamps."""


MEAN_OF_COLORS = np.full((1, 3), 1 / (3 * 255), np.float32)
"""Mean over colors, and conversion from 0..255 to 0..1. OpenCV's pass takes a quarter of the time of NumPy's mean over an axis
of three."""


def difference(frame: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Return the mean absolute difference [H, W] float32, 0..1, around each pixel of images [H, W, 3], 0..255. Noise mostly cancels."""
    apart = cv2.GaussianBlur(cv2.subtract(frame, first, dtype=cv2.CV_32F), (5, 5), 0)
    return cv2.transform(np.abs(apart, out=apart), MEAN_OF_COLORS)


def per_camera(function: Callable[[np.ndarray], np.ndarray], frames: np.ndarray) -> np.ndarray:
    """Return the results of a function of each camera's images [T, H, W, 3], computed on all threads.

    Memory of images in a file is released after each camera.
    """

    def of(camera: int) -> np.ndarray:
        found = function(frames[:, camera])
        release_pages(frames)
        return found

    return np.stack(threads.map_parallel(of, range(frames.shape[1])))


def changed_pixels(frames: np.ndarray) -> np.ndarray:
    """Return [C, H, W] bool, the pixels that differ from the first frame at some frame. frames: [T, C, H, W, 3] uint8."""
    return per_camera(_changed_pixels, frames)


def _changed_pixels(frames: np.ndarray) -> np.ndarray:
    """Return the changed pixels [H, W] of one camera [T, H, W, 3]."""
    first = frames[0].astype(np.float32)
    peak = np.zeros(first.shape[:2], np.float32)
    for frame in frames[1:]:
        np.maximum(peak, difference(frame, first), out=peak)
    return peak > max(MIN_DIFFERENCE, NOISE_MULTIPLE * float(np.quantile(peak, 0.25)))
