"""Where the pictures of a group change: what moves is nowhere else."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np

from splatreel import threads

MIN_DIFFERENCE = 8 / 255
"""Mean absolute difference of the colors around a pixel, 0..1, from which on it counts as changed."""
NOISE = 2.5
"""... and in multiples of what a quarter of the camera's pixels stay below: noise, compression, lamps that flicker."""


def difference(frame: np.ndarray, first: np.ndarray) -> np.ndarray:
    """[H, W] float32, 0..1: how far a picture is from another around each pixel, both [H, W, 3] of 0..255; noise mostly cancels."""
    return np.abs(cv2.GaussianBlur(frame.astype(np.float32) - first, (5, 5), 0)).mean(-1) / 255


def changes(frames: np.ndarray) -> np.ndarray:
    """[C, H, W] bool: where a camera's picture is at some frame not what it was at the first. frames: [T, C, H, W, 3] uint8."""
    with ThreadPoolExecutor(threads.count()) as pool:
        return np.stack(list(pool.map(lambda camera: _changes(frames[:, camera]), range(frames.shape[1]))))


def _changes(frames: np.ndarray) -> np.ndarray:
    """The same of one camera: [T, H, W, 3] to [H, W]."""
    first = frames[0].astype(np.float32)
    peak = np.zeros(first.shape[:2], np.float32)
    for frame in frames[1:]:
        np.maximum(peak, difference(frame, first), out=peak)
    return peak > max(MIN_DIFFERENCE, NOISE * float(np.quantile(peak, 0.25)))
