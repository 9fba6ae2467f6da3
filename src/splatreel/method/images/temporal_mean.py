"""Temporal mean of a keyframe's images: pixels that do not move are averaged over the frames of the group, against noise."""

from __future__ import annotations

import numpy as np

from splatreel.method.images.change import difference, per_camera

MAX_DIFFERENCE = 8 / 255
"""Mean absolute color difference around a pixel, 0..1, above which a frame does not contribute."""


def temporal_mean(frames: np.ndarray) -> np.ndarray:
    """Return the keyframe's images [C, H, W, 3] uint8, averaged over frames that look alike around each pixel.

    Noise falls by up to the square root of T. Slow changes of light, which static points cannot follow, are averaged. Moving
    pixels do not change. A frame's weight is Tukey's bisquare of its difference: 1 for no difference, 0 from `MAX_DIFFERENCE` on.

    Args:
        frames: [T, C, H, W, 3] uint8, the keyframe first.
    """
    return per_camera(mean_of_alike, frames)


def mean_of_alike(frames: np.ndarray, max_difference: float = MAX_DIFFERENCE) -> np.ndarray:
    """Return the first image of one camera, averaged over images [T, H, W, 3] that look alike around each pixel.

    Args:
        frames: [T, H, W, 3] uint8.
        max_difference: Mean absolute color difference, 0..1, above which an image does not contribute.
    """
    first = frames[0].astype(np.float32)
    total, weight = first.copy(), np.ones(first.shape[:2], np.float32)
    for frame in frames[1:]:
        share = np.square(1 - np.square(np.minimum(difference(frame, first) / max_difference, 1)))
        total += share[..., None] * frame
        weight += share
    return np.rint(total / weight[..., None]).astype(np.uint8)
