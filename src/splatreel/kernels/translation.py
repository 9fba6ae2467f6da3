"""How well a shift of points explains what all views show at two moments. A numba kernel on the CPU."""

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
    """[M] mean color difference, 0..1, of points to where each motion takes them, over the views that see them; 1 where none does.

    points: [P, 3] and motions: [M, 3], world. viewmats: [C, 4, 4]; Ks: [C, 3, 3]. here, there: [C, H, W, 3] uint8, pictures of the two
    moments; depths: [C, H, W] of what may hide the points now, infinite for nothing.
    """
    points, motions, viewmats, Ks = (
        np.ascontiguousarray(array, np.float32) for array in (points, motions, viewmats, Ks)
    )
    out = np.ones(len(motions), np.float32)
    inputs = points, motions, viewmats, Ks, here, there, finite(depths), F(near)
    kernel.color_differences.over(len(motions), *inputs, out)
    return out
