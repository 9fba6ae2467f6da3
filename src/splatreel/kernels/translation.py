"""Color differences between two frames under candidate translations of points. A numba kernel on the CPU."""

from __future__ import annotations

import numpy as np

from splatreel.kernels.cpu import translation as kernel
from splatreel.kernels.cpu.scalars import F, finite


def color_differences(
    points: np.ndarray,
    motions: np.ndarray,
    viewmats: np.ndarray,
    Ks: np.ndarray,
    here: np.ndarray,
    there: np.ndarray,
    depths: np.ndarray,
    near: float,
) -> np.ndarray:
    """Return the mean color difference between points and the positions that each candidate translation moves them to.

    Args:
        points: [P, 3] world.
        motions: [M, 3] world, the candidate translations. All points take the same one.
        viewmats: [C, 4, 4] world to camera.
        Ks: [C, 3, 3] pixels.
        here: [C, H, W, 3] uint8, images of the first frame.
        there: [C, H, W, 3] uint8, images of the second frame.
        depths: [C, H, W], depths that may hide points in the first frame; infinite where nothing does.
        near: Smallest depth that a view sees, world units.

    Returns:
        [M] float32, 0..1, the mean over the views that see a point in both frames; 1 where no view does.
    """
    points, motions, viewmats, Ks = (
        np.ascontiguousarray(array, np.float32) for array in (points, motions, viewmats, Ks)
    )
    out = np.ones(len(motions), np.float32)
    inputs = points, motions, viewmats, Ks, here, there, finite(depths), F(near)
    kernel.color_differences.over(len(motions), *inputs, out)
    return out
