"""Clean plates: each camera's picture of what is always there, from frames sampled through a whole video.

A scene that is reconstructed from them has nobody in it, and every stretch of the video can start from it.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import cv2
import numpy as np

from splatreel import threads

SAME = 10 / 255
"""Mean absolute difference of the colors around a pixel, 0..1, up to which a frame takes part in the mean there."""
STILL = 4 / 255
"""Mean absolute difference up to which a frame counts as showing what is always there, where the video has little noise. The clothes of
somebody who stays in one place while moving differ by less than `SAME`, and their mean is a smear that no other camera sees
(docs/experiments/2026-11-26-gray-smears.md)."""
NOISE = 4.0
"""The same in multiples of the camera's noise, where that is more; at most `SAME`."""
ENOUGH = 0.5
"""Share of the frames that must show the same for a pixel to be known: what is there for less may be somebody standing."""


class CleanPlates(NamedTuple):
    """images: [C, H, W, 3] uint8. unknown: [C, H, W] bool, where too few frames show the same, and the picture means nothing."""

    images: np.ndarray
    unknown: np.ndarray


def clean_plates(frames: np.ndarray) -> CleanPlates:
    """From frames [S, C, H, W, 3] uint8, sampled evenly through a video; exposures and light have been evened out."""
    with ThreadPoolExecutor(threads.count()) as pool:
        found = list(pool.map(lambda camera: _plate(frames[:, camera]), range(frames.shape[1])))
    return CleanPlates(np.stack([image for image, _ in found]), np.stack([unknown for _, unknown in found]))


def _plate(frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of one camera, [S, H, W, 3]: the mean of the frames that agree with their median, pixel by pixel."""
    middle = np.median(frames, 0).astype(np.float32)
    total, weight = np.zeros_like(middle), np.zeros(middle.shape[:2], np.float32)
    differences = np.empty((len(frames), *middle.shape[:2]), np.float32)
    for number, frame in enumerate(frames):
        difference = differences[number] = np.abs(cv2.GaussianBlur(frame - middle, (5, 5), 0)).mean(-1) / 255
        share = np.square(1 - np.square(np.minimum(difference / SAME, 1)))
        total += share[..., None] * frame
        weight += share
    mean = np.where(weight[..., None] > 0, total / np.maximum(weight, 1e-6)[..., None], middle)
    still = min(max(STILL, NOISE * float(np.median(differences))), SAME)
    return np.rint(mean).astype(np.uint8), (differences < still).sum(0) < ENOUGH * len(frames)
