"""Scene flow: the motion of points in space that the optical flow of all views agrees on. A numba kernel on the CPU."""

from __future__ import annotations

import numpy as np

from splatreel.kernels.cpu import sceneflow as kernel
from splatreel.kernels.cpu.scalars import finite

FLOATS = np.arange(1 << 16, dtype=np.uint16).view(np.float16).astype(np.float32)
"""The value of every half-precision number, which numba cannot read."""


def solve(
    means: np.ndarray,
    last: np.ndarray,
    viewmats: np.ndarray,
    Ks: np.ndarray,
    flows: np.ndarray,
    depths: np.ndarray,
    near: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Motion [N, 3] of points to the next frame, and its certainty [N]: how many views agree, less one; 0 for not at all.

    means, last: [N, 3] float32, places and the motion before. viewmats: [C, 4, 4]; Ks: [C, 3, 3]. flows: [C, H, W, 2] float16,
    where each view's pixels go. depths: [C, ceil(H / 2), ceil(W / 2)] what each view sees, infinite for nothing.
    """
    motion, certainty = np.empty_like(last), np.empty(len(last), np.float32)
    inputs = means, last, viewmats, Ks, flows.view(np.uint16), FLOATS, finite(depths), near
    kernel.solve.over(len(means), *inputs, motion, certainty, grain=64)
    return motion, certainty


def pixels_needed(
    means: np.ndarray, viewmats: np.ndarray, Ks: np.ndarray, depths: np.ndarray, height: int, width: int, near: float
) -> np.ndarray:
    """The pixels [C, height, width] bool of `flows` that `solve` reads; the arguments are those of `solve`."""
    marks = np.zeros((len(viewmats), height, width), np.bool_)
    kernel.mark_pixels.over(len(marks), means, viewmats, Ks, finite(depths), near, marks)
    return marks
