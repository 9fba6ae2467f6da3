"""Scene flow: the 3D motion of points that fits the optical flow of all views. A numba kernel on the CPU."""

from __future__ import annotations

import numpy as np

from splatreel.kernels.cpu import sceneflow as kernel
from splatreel.kernels.cpu.scalars import finite

FLOATS = np.arange(1 << 16, dtype=np.uint16).view(np.float16).astype(np.float32)
"""The value of every half-precision number. Numba cannot read half precision, so its kernels look values up here."""


def solve(
    means: np.ndarray,
    last: np.ndarray,
    viewmats: np.ndarray,
    Ks: np.ndarray,
    flows: np.ndarray,
    depths: np.ndarray,
    near: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Solve for the motion of points to the next frame by robust least squares.

    Args:
        means: [N, 3] float32 world, the points.
        last: [N, 3] float32, their motion to this frame. It fills in directions that the views do not determine.
        viewmats: [C, 4, 4] world to camera.
        Ks: [C, 3, 3] pixels.
        flows: [C, H, W, 2] float16, the optical flow of each view to the next frame, pixels.
        depths: [C, ceil(H / 2), ceil(W / 2)], the depths that each view sees; infinite where there is nothing.
        near: Smallest depth that a view sees, world units.

    Returns:
        The motion [N, 3] float32 world, and its certainty [N] float32: the weighted number of views that agree, less one, at least 0.
    """
    motion, certainty = np.empty_like(last), np.empty(len(last), np.float32)
    inputs = means, last, viewmats, Ks, flows.view(np.uint16), FLOATS, finite(depths), near
    kernel.solve.over(len(means), *inputs, motion, certainty, grain=64)
    return motion, certainty


def pixels_needed(
    means: np.ndarray, viewmats: np.ndarray, Ks: np.ndarray, depths: np.ndarray, height: int, width: int, near: float
) -> np.ndarray:
    """Return the pixels [C, height, width] bool of `flows` that `solve` would read with the same arguments."""
    marks = np.zeros((len(viewmats), height, width), np.bool_)
    kernel.mark_pixels.over(len(marks), means, viewmats, Ks, finite(depths), near, marks)
    return marks
