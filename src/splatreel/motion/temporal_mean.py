"""Temporal mean of a keyframe's pictures: what does not move is averaged over the frames of its group, against noise."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from splatreel import threads
from splatreel.capture.frame_file import release_pages
from splatreel.motion.change import difference

SAME = 8 / 255
"""Mean absolute difference of the colors around a pixel, from which on a frame says nothing about the keyframe."""


def temporal_mean(frames: np.ndarray) -> np.ndarray:
    """The keyframe's pictures, each pixel averaged over the frames in which its surroundings look as they do at the keyframe.

    frames: [T, C, H, W, 3] uint8, the keyframe first. Returns [C, H, W, 3] uint8. Noise falls by up to the root of T, and slow
    changes of light, which static points cannot follow, are met in their middle; what moves is left as it was. A frame weighs by
    Tukey's bisquare of its difference: 1 where it is none, 0 from `SAME` on.
    """

    def of(camera: int) -> np.ndarray:
        found = _temporal_mean(frames[:, camera])
        release_pages(frames)
        return found

    with ThreadPoolExecutor(threads.count()) as pool:
        return np.stack(list(pool.map(of, range(frames.shape[1]))))


def _temporal_mean(frames: np.ndarray) -> np.ndarray:
    """The same of one camera: [T, H, W, 3] to [H, W, 3]."""
    first = frames[0].astype(np.float32)
    total, weight = first.copy(), np.ones(first.shape[:2], np.float32)
    for frame in frames[1:]:
        share = np.square(1 - np.square(np.minimum(difference(frame, first) / SAME, 1)))
        total += share[..., None] * frame
        weight += share
    return np.rint(total / weight[..., None]).astype(np.uint8)
