"""Motion of points: cubic splines in time blended over shared nodes, quaternion products, and the rigidity loss.

Each function makes one pass over memory. Sums over points that
share a node or a neighbor have a fixed order, so that results have the same bits for any number of threads.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from splatreel.base.jit import D1, F1, F2, F3, FLOAT, L1, L2, kernel, range_kernel
from splatreel.kernels.scalars import HALF, ONE, TWO, ZERO, F, sign

Skin = tuple[np.ndarray, np.ndarray]
"""index [N, K] int64 and share [N, K]: the nodes of each point and their weights."""


GRAIN = 4096
"""Smallest number of points that is worth a thread."""
BANDS = 16
"""Number of parts of the points with separate sums of node gradients. It does not depend on the number of threads."""


def spline(controls: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the values [R, D] of splines. controls: [4, R, D], the knots that count. weights: [4]."""
    out = np.empty(controls.shape[1:], np.float32)
    _spline.over(len(out), controls, weights, out, grain=GRAIN)
    return out


def offsets(
    nodes: np.ndarray, points: np.ndarray, weights: np.ndarray, skin: Skin, unit: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return dx [N, 3] and dq [N, 4] of points at one time: the points' own splines plus those of their nodes.

    `nodes` [4, M, 7] and `points` [4, N, 7] are the controls that count: dx in units of `unit`, and dq without its
    identity. `weights` [4] are those of the four knots. `skin` are the nodes of each point and their weights.
    """
    n = points.shape[1]
    dx, dq = np.empty((n, 3), np.float32), np.empty((n, 4), np.float32)
    _offsets.over(n, spline(nodes, weights), points, weights, *skin, F(unit), dx, dq, grain=GRAIN)
    return dx, dq


def offsets_gradient(
    d_dx: np.ndarray, d_dq: np.ndarray, skin: Skin, nodes: int, unit: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the gradients [M, 7] and [N, 7] to the values of the splines of nodes and points, from those to dx and dq."""
    d_points, sums = np.empty((len(d_dx), 7), np.float32), np.zeros((BANDS, nodes, 7), np.float32)
    _offsets_gradient.over(BANDS, d_dx, d_dq, *skin, F(unit), sums, d_points)
    return sums.sum(0), d_points


def product_sum(controls: np.ndarray, weights: np.ndarray, slopes: np.ndarray) -> float:
    """Return the sum over R rows of controls [K, R, 7], weighted by [K], times slopes [R, 7]: the change along the gradient."""
    sums = np.empty(BANDS, np.float64)
    _product_sum.over(BANDS, controls, weights, slopes, sums)
    return float(sums.sum())


def arap(
    means: np.ndarray, dx: np.ndarray, dq: np.ndarray, neighbor: np.ndarray, weights: np.ndarray, unit: float
) -> tuple[float, np.ndarray, np.ndarray]:
    """Return the as-rigid-as-possible loss and its gradients to dx [N, 3] and dq [N, 4] (paper, section 4.2).

    Each point of means [N, 3] and its `neighbor` [N] should turn and move alike, and keep their distance, measured in
    `unit`. The loss is the mean over the points, weighted by `weights` [N].
    """
    n = len(means)
    losses, units = np.empty(n, np.float32), np.empty((n, 5), np.float32)
    here, there = np.empty((n, 7), np.float32), np.empty((n, 7), np.float32)
    d_dx, d_dq = np.empty_like(dx), np.empty_like(dq)
    _normalize.over(n, dq, units, grain=GRAIN)
    scales = F(1 / unit), F(1 / max(n, 1))
    _pairs.over(n, means, dx, units, neighbor, weights, *scales, losses, here, there, grain=GRAIN)
    _scatter(neighbor, there, here)
    _split_gradient.over(n, units, here, d_dx, d_dq, grain=GRAIN)
    return float(losses.sum(dtype=np.float64)), d_dx, d_dq


@njit(inline="always")
def _value(controls, weights, i, d):
    early = weights[0] * controls[0, i, d] + weights[1] * controls[1, i, d]
    return early + weights[2] * controls[2, i, d] + weights[3] * controls[3, i, d]


@range_kernel(F3, F1, F2)
def _spline(first, last, controls, weights, out):
    for i in range(first, last):
        for d in range(out.shape[1]):
            out[i, d] = _value(controls, weights, i, d)


@range_kernel(F2, F3, F1, L2, F2, FLOAT, F2, F2)
def _offsets(first, last, nodes, points, weights, index, share, unit, dx, dq):
    for i in range(first, last):
        for d in range(7):
            value = _value(points, weights, i, d)
            for k in range(index.shape[1]):
                value += share[i, k] * nodes[index[i, k], d]
            if d < 3:
                dx[i, d] = unit * value
            else:
                dq[i, d - 3] = value + (ONE if d == 3 else ZERO)


@range_kernel(F2, F2, L2, F2, FLOAT, F3, F2)
def _offsets_gradient(first, last, d_dx, d_dq, index, share, unit, sums, d_points):
    n = d_dx.shape[0]
    for band in range(first, last):
        for i in range(band * n // BANDS, (band + 1) * n // BANDS):
            for d in range(7):
                slope = unit * d_dx[i, d] if d < 3 else d_dq[i, d - 3]
                d_points[i, d] = slope
                for k in range(index.shape[1]):
                    sums[band, index[i, k], d] += share[i, k] * slope


@range_kernel(F3, F1, F2, D1)
def _product_sum(first, last, controls, weights, slopes, sums):
    n = slopes.shape[0]
    for band in range(first, last):
        total = 0.0
        for k in range(controls.shape[0]):
            part = ZERO
            for i in range(band * n // BANDS, (band + 1) * n // BANDS):
                for d in range(7):
                    part += controls[k, i, d] * slopes[i, d]
            total += weights[k] * part
        sums[band] = total


@njit(inline="always")
def product(aw, ax, ay, az, bw, bx, by, bz):
    """Return the Hamilton product of two quaternions, wxyz."""
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


@njit(inline="always")
def _unit(q, i):
    """Return the normalized quaternion i, and one over its norm."""
    w, x, y, z = q[i, 0], q[i, 1], q[i, 2], q[i, 3]
    inverse = ONE / max(math.sqrt(w * w + x * x + y * y + z * z), F(1e-12))
    return w * inverse, x * inverse, y * inverse, z * inverse, inverse


@njit(inline="always")
def unit_gradient(w, x, y, z, inverse, gw, gx, gy, gz):
    """Return the gradient to a quaternion before normalization from the gradient to the unit quaternion."""
    along = gw * w + gx * x + gy * y + gz * z
    return (
        (gw - along * w) * inverse,
        (gx - along * x) * inverse,
        (gy - along * y) * inverse,
        (gz - along * z) * inverse,
    )


@range_kernel(F2, F2)
def _normalize(first, last, dq, units):
    for i in range(first, last):
        units[i, 0], units[i, 1], units[i, 2], units[i, 3], units[i, 4] = _unit(dq, i)


@njit(inline="always")
def _cross(ax, ay, az, bx, by, bz):
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@njit(inline="always")
def _rotate(q, i, vx, vy, vz):
    """Return v rotated by the unit quaternion i = (w, u): v + 2 w u x v + 2 u x (u x v)."""
    w, x, y, z = q[i, 0], q[i, 1], q[i, 2], q[i, 3]
    cx, cy, cz = _cross(x, y, z, vx, vy, vz)
    ex, ey, ez = _cross(x, y, z, cx, cy, cz)
    return vx + TWO * (w * cx + ex), vy + TWO * (w * cy + ey), vz + TWO * (w * cz + ez)


@njit(inline="always")
def _rotate_gradient(q, i, vx, vy, vz, gx, gy, gz):
    """Return the gradient of g . rotate(q, v) to q, where u x (u x v) is u (u . v) - v (u . u)."""
    w, x, y, z = q[i, 0], q[i, 1], q[i, 2], q[i, 3]
    cx, cy, cz = _cross(x, y, z, vx, vy, vz)
    bx, by, bz = _cross(vx, vy, vz, gx, gy, gz)
    uv, ug, vg = x * vx + y * vy + z * vz, x * gx + y * gy + z * gz, TWO * (vx * gx + vy * gy + vz * gz)
    return (
        TWO * (gx * cx + gy * cy + gz * cz),
        TWO * (w * bx + gx * uv + vx * ug - x * vg),
        TWO * (w * by + gy * uv + vy * ug - y * vg),
        TWO * (w * bz + gz * uv + vz * ug - z * vg),
    )


@range_kernel(F2, F2, F2, L1, F1, FLOAT, FLOAT, F1, F2, F2)
def _pairs(first, last, means, dx, units, neighbor, weights, per_unit, share, losses, here, there):
    """Compute each pair's part of the mean loss, and the gradients to (dx, unit quaternion) of the point and of its neighbor."""
    for i in range(first, last):
        j, weight = neighbor[i], weights[i] * share
        scale = weight * per_unit
        hx, hy, hz = (
            HALF * (means[i, 0] - means[j, 0]),
            HALF * (means[i, 1] - means[j, 1]),
            HALF * (means[i, 2] - means[j, 2]),
        )
        vx, vy, vz = TWO * hx + dx[i, 0] - dx[j, 0], TWO * hy + dx[i, 1] - dx[j, 1], TWO * hz + dx[i, 2] - dx[j, 2]
        ax, ay, az = _rotate(units, i, hx, hy, hz)
        bx, by, bz = _rotate(units, j, hx, hy, hz)
        sx, sy, sz = vx - ax - bx, vy - ay - by, vz - az - bz
        length = math.sqrt(vx * vx + vy * vy + vz * vz + F(1e-12))
        stretch = TWO * math.sqrt(hx * hx + hy * hy + hz * hz) - length
        turn = ZERO
        for c in range(4):
            turn += abs(units[i, c] - units[j, c])
        losses[i] = weight * turn + scale * (abs(sx) + abs(sy) + abs(sz) + abs(stretch))
        gx, gy, gz = scale * sign(sx), scale * sign(sy), scale * sign(sz)
        pull = -scale * sign(stretch) / length
        here[i, 0], here[i, 1], here[i, 2] = gx + pull * vx, gy + pull * vy, gz + pull * vz
        here[i, 3], here[i, 4], here[i, 5], here[i, 6] = _rotate_gradient(units, i, hx, hy, hz, -gx, -gy, -gz)
        there[i, 3], there[i, 4], there[i, 5], there[i, 6] = _rotate_gradient(units, j, hx, hy, hz, -gx, -gy, -gz)
        for c in range(3):
            there[i, c] = -here[i, c]
        for c in range(4):
            turned = weight * sign(units[i, c] - units[j, c])
            here[i, 3 + c] += turned
            there[i, 3 + c] -= turned


@kernel(L1, F2, F2)
def _scatter(index, rows, totals):
    for i in range(rows.shape[0]):
        for d in range(rows.shape[1]):
            totals[index[i], d] += rows[i, d]


@range_kernel(F2, F2, F2, F2)
def _split_gradient(first, last, units, gradient, d_dx, d_dq):
    for i in range(first, last):
        w, x, y, z, inverse = units[i, 0], units[i, 1], units[i, 2], units[i, 3], units[i, 4]
        d_dx[i, 0], d_dx[i, 1], d_dx[i, 2] = gradient[i, 0], gradient[i, 1], gradient[i, 2]
        gw, gx, gy, gz = gradient[i, 3], gradient[i, 4], gradient[i, 5], gradient[i, 6]
        d_dq[i, 0], d_dq[i, 1], d_dq[i, 2], d_dq[i, 3] = unit_gradient(w, x, y, z, inverse, gw, gx, gy, gz)
