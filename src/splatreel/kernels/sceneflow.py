"""Scene flow: the 3D motion of points that fits the optical flow of all views. One task per point."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from splatreel.base.jit import B3, DOUBLE, F1, F2, F3, array, range_kernel
from splatreel.kernels.scalars import finite

FLOATS = np.arange(1 << 16, dtype=np.uint16).view(np.float16).astype(np.float32)
"""The value of every half-precision number. Numba cannot read half precision, so its kernels look values up here."""
HALVES = array(np.uint16, 4)
ROUNDS = 3
"""Number of least-squares solutions, each with new weights."""
TOLERANCE = 1.0
"""Residual, in pixels, at which the flow of a view has half of its weight."""
HIDDEN = 1.03
"""A point is hidden from a view if its depth is larger than this many times the depth at its pixel."""
DAMPING = 1e-3
"""Weight of the previous motion, as a share of the trace of the normal matrix. It fills in directions that views do not determine."""


def solve(
    means: np.ndarray,
    last: np.ndarray,
    viewmats: np.ndarray,
    Ks: np.ndarray,
    flows: np.ndarray,
    depths: np.ndarray,
    near: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Solve for the motion [N, 3] of points to the next frame by robust least squares. Return it with its certainty [N].

    The certainty is the weighted number of views that agree, less one, at least 0. `last` [N, 3] is the motion to this
    frame, which fills in directions that the views do not determine. `flows` [C, H, W, 2] float16 are pixels. `depths`
    [C, ceil(H / 2), ceil(W / 2)] are infinite where there is nothing.
    """
    motion, certainty = np.empty_like(last), np.empty(len(last), np.float32)
    inputs = means, last, viewmats, Ks, flows.view(np.uint16), FLOATS, finite(depths), near
    _solve.over(len(means), *inputs, motion, certainty, grain=64)
    return motion, certainty


def pixels_needed(
    means: np.ndarray, viewmats: np.ndarray, Ks: np.ndarray, depths: np.ndarray, height: int, width: int, near: float
) -> np.ndarray:
    """Return the pixels [C, height, width] bool of `flows` that `solve` would read with the same arguments."""
    marks = np.zeros((len(viewmats), height, width), np.bool_)
    _mark_pixels.over(len(marks), means, viewmats, Ks, finite(depths), near, marks)
    return marks


@njit(inline="always")
def _project(means, i, V, K, height, width, depth, near):
    """Return row and column of point i in a view, -1 if it is not visible, and the point in camera coordinates."""
    x, y, z = means[i, 0], means[i, 1], means[i, 2]
    Z = V[2, 0] * x + V[2, 1] * y + V[2, 2] * z + V[2, 3]
    X, Y = V[0, 0] * x + V[0, 1] * y + V[0, 2] * z + V[0, 3], V[1, 0] * x + V[1, 1] * y + V[1, 2] * z + V[1, 3]
    p = q = -1
    if near < Z:
        u, v = K[0, 0] / Z * X + K[0, 2], K[1, 1] / Z * Y + K[1, 2]
        if 0 <= u < width and 0 <= v < height and depth[int(v) // 2, int(u) // 2] * HIDDEN >= Z:
            p, q = int(v), int(u)
    return p, q, X, Y, Z


@range_kernel(F2, F3, F3, F3, DOUBLE, B3)
def _mark_pixels(first, last, means, viewmats, Ks, depths, near, marks):
    for c in range(first, last):
        for i in range(means.shape[0]):
            p, q, _, _, _ = _project(means, i, viewmats[c], Ks[c], marks.shape[1], marks.shape[2], depths[c], near)
            if p >= 0:
                marks[c, p, q] = True


@njit(inline="always")
def _observe(means, i, V, K, field, floats, depth, near, row):
    """Write the observation of point i by one view: the Jacobian [2, 3], pixels per world unit, and the flow [2].

    Return whether the view sees the point.
    """
    p, q, X, Y, Z = _project(means, i, V, K, field.shape[0], field.shape[1], depth, near)
    if p < 0:
        return False
    gx, gy = K[0, 0] / Z, K[1, 1] / Z
    for k in range(3):
        row[k], row[3 + k] = gx * (V[0, k] - X / Z * V[2, k]), gy * (V[1, k] - Y / Z * V[2, k])
    row[6], row[7] = floats[field[p, q, 0]], floats[field[p, q, 1]]
    return True


@njit(inline="always")
def _cholesky(A, b):
    """Solve A x = b for a positive definite matrix A, given as xx, xy, xz, yy, yz, zz."""
    l00 = math.sqrt(A[0])
    l10, l20 = A[1] / l00, A[2] / l00
    l11 = math.sqrt(A[3] - l10 * l10)
    l21 = (A[4] - l20 * l10) / l11
    l22 = math.sqrt(A[5] - l20 * l20 - l21 * l21)
    y0 = b[0] / l00
    y1 = (b[1] - l10 * y0) / l11
    z = (b[2] - l20 * y0 - l21 * y1) / (l22 * l22)
    y = (y1 - l21 * z) / l11
    return (y0 - l10 * y - l20 * z) / l00, y, z


@range_kernel(F2, F2, F3, F3, HALVES, F1, F3, DOUBLE, F2, F1, allocates=True)
def _solve(begin, end, means, last, viewmats, Ks, fields, floats, depths, near, motion, certainty):
    """fields: the bits of half-precision flows. floats: the value of all such bits."""
    for i in range(begin, end):
        rows, count = np.empty((viewmats.shape[0], 8)), 0
        for c in range(viewmats.shape[0]):
            if _observe(means, i, viewmats[c], Ks[c], fields[c], floats, depths[c], near, rows[count]):
                count += 1
        x, y, z = float(last[i, 0]), float(last[i, 1]), float(last[i, 2])
        total = 0.0
        for turn in range(ROUNDS):
            A, b, total = np.zeros(6), np.zeros(3), 0.0
            for c in range(count):
                j = rows[c]
                across = j[0] * x + j[1] * y + j[2] * z - j[6]
                down = j[3] * x + j[4] * y + j[5] * z - j[7]
                weight = 1.0
                if turn > 0:
                    weight = 1 / (1 + (across * across + down * down) / (TOLERANCE * TOLERANCE))
                total += weight
                A[0] += weight * (j[0] * j[0] + j[3] * j[3])
                A[1] += weight * (j[0] * j[1] + j[3] * j[4])
                A[2] += weight * (j[0] * j[2] + j[3] * j[5])
                A[3] += weight * (j[1] * j[1] + j[4] * j[4])
                A[4] += weight * (j[1] * j[2] + j[4] * j[5])
                A[5] += weight * (j[2] * j[2] + j[5] * j[5])
                for k in range(3):
                    b[k] += weight * (j[k] * j[6] + j[3 + k] * j[7])
            damping = DAMPING * max(A[0] + A[3] + A[5], 1e-9)
            A[0], A[3], A[5] = A[0] + damping, A[3] + damping, A[5] + damping
            for k in range(3):
                b[k] += damping * last[i, k]
            x, y, z = _cholesky(A, b)
        motion[i, 0], motion[i, 1], motion[i, 2] = x, y, z
        certainty[i] = max(total - 1, 0.0)
