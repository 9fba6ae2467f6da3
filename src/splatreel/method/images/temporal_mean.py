"""Means of images over time: the temporal mean of a keyframe, against noise, and the clean plates of a video, without people."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from splatreel.base import threads
from splatreel.method.images.change import difference, per_camera

MAX_DIFFERENCE = 8 / 255
"""Mean absolute color difference around a pixel, 0..1, above which a frame does not contribute."""


def temporal_mean(frames: np.ndarray) -> np.ndarray:
    """Return the keyframe's images [C, H, W, 3] uint8, averaged over frames that look alike around each pixel.

    Noise falls by up to the square root of T. Slow changes of light, which static points cannot follow, are averaged.
    Moving pixels do not change. A frame's weight is Tukey's bisquare of its difference: 1 for no difference, 0 from
    `MAX_DIFFERENCE` on. `frames` [T, C, H, W, 3] start with the keyframe.
    """
    return per_camera(mean_of_alike, frames)


def mean_of_alike(frames: np.ndarray, max_difference: float = MAX_DIFFERENCE) -> np.ndarray:
    """Return the first image of one camera, averaged over images [T, H, W, 3] that look alike around each pixel."""
    first = frames[0].astype(np.float32)
    total, weight = first.copy(), np.ones(first.shape[:2], np.float32)
    for frame in frames[1:]:
        share = np.square(1 - np.square(np.minimum(difference(frame, first) / max_difference, 1)))
        total += share[..., None] * frame
        weight += share
    return np.rint(total / weight[..., None]).astype(np.uint8)


MEAN_DIFFERENCE = 10 / 255
"""Mean absolute color difference around a pixel, 0..1, up to which a frame contributes to the mean."""
PERMANENT_DIFFERENCE = 4 / 255
"""Mean absolute difference up to which a frame counts as showing the permanent scene, if the video has little noise. The
clothes of somebody who stays in one place while moving differ by less than `MEAN_DIFFERENCE`, and their mean is a smear that no other
camera sees (docs/experiments/2026-11-26-gray-smears.md)."""
NOISE_MULTIPLE = 4.0
"""The same limit in multiples of the camera's noise, if that is more; at most `MEAN_DIFFERENCE`."""
PERMANENT_SHARE = 0.5
"""Share of the frames that must look alike for a pixel to be known. Content that is there for less may be somebody standing."""


class CleanPlates(NamedTuple):
    """images: [C, H, W, 3] uint8. unknown: [C, H, W] bool, pixels for which too few frames look alike."""

    images: np.ndarray
    unknown: np.ndarray


def clean_plates(frames: np.ndarray) -> CleanPlates:
    """Compute clean plates from frames [S, C, H, W, 3] uint8, sampled evenly through a video, with exposure and light evened out.

    They show the permanent scene, without people, from which every chapter can start.
    """
    found = threads.map_parallel(_plate, frames.swapaxes(0, 1))
    return CleanPlates(np.stack([image for image, _ in found]), np.stack([unknown for _, unknown in found]))


def _plate(frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the clean plate of one camera: the mean over the frames [S, H, W, 3] that agree with their median."""
    middle = np.median(frames, 0).astype(np.float32)
    total, weight = np.zeros_like(middle), np.zeros(middle.shape[:2], np.float32)
    differences = np.empty((len(frames), *middle.shape[:2]), np.float32)
    for number, frame in enumerate(frames):
        difference = differences[number] = np.abs(cv2.GaussianBlur(frame - middle, (5, 5), 0)).mean(-1) / 255
        share = np.square(1 - np.square(np.minimum(difference / MEAN_DIFFERENCE, 1)))
        total += share[..., None] * frame
        weight += share
    mean = np.where(weight[..., None] > 0, total / np.maximum(weight, 1e-6)[..., None], middle)
    still = min(max(PERMANENT_DIFFERENCE, NOISE_MULTIPLE * float(np.median(differences))), MEAN_DIFFERENCE)
    return np.rint(mean).astype(np.uint8), (differences < still).sum(0) < PERMANENT_SHARE * len(frames)
