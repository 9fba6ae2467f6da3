"""Perspective projection of 3D Gaussians to 2D (EWA splatting, as in 3DGS and gsplat), forward and backward.

Points are projected in blocks of `LANES`. A block is a float32 array on the stack with one row of `LANES` floats per quantity, so that
the compiler turns each loop over the lanes into vector instructions. Lanes beyond the last point repeat the last point.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit, types

from splatreel.base.jit import F1, F2, FLOAT, I1, range_kernel
from splatreel.kernels.rows import choose, stack_floats
from splatreel.kernels.scalars import HALF, ONE, TWO, ZERO, F

LIMITS = types.UniTuple(FLOAT, 4)
GRAIN = 4096
"""Smallest number of points that is worth a thread."""
LANES = 16
"""Points in a block."""
MEAN, QUAT, SCALE, POINT_ROWS = 0, 3, 7, 10
"""First row of each quantity in a block of points, and the number of rows."""
MEAN2D, CONIC, DEPTH, RADIUS, SPLAT_ROWS = 0, 2, 5, 6, 7
"""First row of each quantity in a block of splats, and the number of rows."""
POINT_FLOATS, SPLAT_FLOATS = POINT_ROWS * LANES, SPLAT_ROWS * LANES

BLUR = 0.3
"""Added to the diagonal of the 2D covariance, square pixels, so that no splat is thinner than about a pixel."""
FINE_BLUR = 0.1
"""The blur of antialiased images, about the area of a pixel (Mip-Splatting, section 4.2)."""
EXTENT = F(3.33)
"""Distance at which the alpha of an opaque splat is 1/255, in standard deviations: sqrt(2 ln 255)."""


@dataclass(frozen=True)
class Pinhole:
    """A pinhole camera and its drawing options.

    viewmat: [4, 4] float32 world to camera. K: [3, 3] float32 pixels. width, height: pixels. near: smallest depth drawn. blur: added to
    the diagonal of the 2D covariances, square pixels.
    """

    viewmat: np.ndarray
    K: np.ndarray
    width: int
    height: int
    near: float
    blur: float = BLUR

    @cached_property
    def lens(self) -> np.ndarray:
        """fx, fy, cx, cy, and the ranges of x/z and y/z for the Jacobian: 1.3 times the field of view, as in gsplat."""
        fx, fy, cx, cy = (float(self.K[index]) for index in ((0, 0), (1, 1), (0, 2), (1, 2)))
        margin_x, margin_y = 0.15 * self.width / fx, 0.15 * self.height / fy
        low_x, high_x = -cx / fx - margin_x, (self.width - cx) / fx + margin_x
        low_y, high_y = -cy / fy - margin_y, (self.height - cy) / fy + margin_y
        return np.array([fx, fy, cx, cy, low_x, high_x, low_y, high_y], np.float32)

    @property
    def limits(self) -> tuple[np.float32, np.float32, np.float32, np.float32]:
        """Width, height, near and blur as float32."""
        return F(self.width), F(self.height), F(self.near), F(self.blur)


def kept_area(xx, xy, yy):
    """Return det C / det(C + FINE_BLUR) of blurred conics, for arrays or tensors. Rounding may make it negative."""
    return 1 - FINE_BLUR * (xx + yy) + FINE_BLUR**2 * (xx * yy - xy * xy)


def forward(
    means: np.ndarray, quats: np.ndarray, scales: np.ndarray, view: Pinhole
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return means2d [N, 2], conics [N, 3], depths [N] and radii [N] int32. Rows of culled points are zero."""
    n = len(means)
    means2d, conics = np.empty((n, 2), np.float32), np.empty((n, 3), np.float32)
    depths, radii = np.empty(n, np.float32), np.empty(n, np.int32)
    inputs = means, quats, scales, view.viewmat, view.lens, view.limits
    _forward.over(n, *inputs, means2d, conics, depths, radii, grain=GRAIN)
    return means2d, conics, depths, radii


def backward(
    means: np.ndarray,
    quats: np.ndarray,
    scales: np.ndarray,
    conics: np.ndarray,
    d_means2d: np.ndarray,
    d_conics: np.ndarray,
    d_depths: np.ndarray,
    radii: np.ndarray,
    view: Pinhole,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the gradients to means, quats and scales. conics and radii are those that `forward` returned."""
    d_means, d_quats, d_scales = np.empty_like(means), np.empty_like(quats), np.empty_like(scales)
    inputs = (means, quats, scales, view.viewmat, view.lens, conics, radii)
    _backward.over(len(means), *inputs, d_means2d, d_conics, d_depths, d_means, d_quats, d_scales, grain=GRAIN)
    return d_means, d_quats, d_scales


@njit(inline="always")
def _rotation(w, x, y, z):
    """Return the rotation matrix of a unit quaternion, row by row."""
    return (
        ONE - TWO * (y * y + z * z),
        TWO * (x * y - w * z),
        TWO * (x * z + w * y),
        TWO * (x * y + w * z),
        ONE - TWO * (x * x + z * z),
        TWO * (y * z - w * x),
        TWO * (x * z - w * y),
        TWO * (y * z + w * x),
        ONE - TWO * (x * x + y * y),
    )


@njit(inline="always")
def load_rows(source, start, count, columns, block, row):
    """Copy `count` rows of source [N, columns], from row `start` on, into a block, from its row `row` on."""
    for lane in range(LANES):
        i = start + min(lane, count - 1)
        for c in range(columns):
            block[(row + c) * LANES + lane] = source[i, c]


@njit(inline="always")
def store_rows(block, row, start, count, columns, target):
    """Copy rows of a block, from row `row` on, into `count` rows of target [N, columns], from row `start` on."""
    for lane in range(count):
        for c in range(columns):
            target[start + lane, c] = block[(row + c) * LANES + lane]


@njit(inline="always")
def _load_points(means, quats, scales, start, count, points):
    load_rows(means, start, count, 3, points, MEAN)
    load_rows(quats, start, count, 4, points, QUAT)
    load_rows(scales, start, count, 3, points, SCALE)


@njit(inline="always")
def store_splats(splats, start, count, means2d, conics, depths, radii):
    """Copy a block of splats into the arrays that `forward` returns."""
    store_rows(splats, MEAN2D, start, count, 2, means2d)
    store_rows(splats, CONIC, start, count, 3, conics)
    for lane in range(count):
        depths[start + lane] = splats[DEPTH * LANES + lane]
        radii[start + lane] = np.int32(splats[RADIUS * LANES + lane])


@njit(inline="always")
def unit_quaternion(block, row, lane):
    """Return the normalized quaternion of one lane, from row `row` of a block on, and one over its norm."""
    w, x = block[row * LANES + lane], block[(row + 1) * LANES + lane]
    y, z = block[(row + 2) * LANES + lane], block[(row + 3) * LANES + lane]
    inverse = ONE / max(math.sqrt(w * w + x * x + y * y + z * z), F(1e-12))
    return w * inverse, x * inverse, y * inverse, z * inverse, inverse


@njit(inline="always")
def _to_camera(V, x, y, z):
    return (
        V[0, 0] * x + V[0, 1] * y + V[0, 2] * z + V[0, 3],
        V[1, 0] * x + V[1, 1] * y + V[1, 2] * z + V[1, 3],
        V[2, 0] * x + V[2, 1] * y + V[2, 2] * z + V[2, 3],
    )


@njit(inline="always")
def _jacobian_rows(V, gx, gy, u, v):
    """Return the two rows of the projection's Jacobian times the world-to-camera rotation."""
    return (
        gx * (V[0, 0] - u * V[2, 0]),
        gx * (V[0, 1] - u * V[2, 1]),
        gx * (V[0, 2] - u * V[2, 2]),
        gy * (V[1, 0] - v * V[2, 0]),
        gy * (V[1, 1] - v * V[2, 1]),
        gy * (V[1, 2] - v * V[2, 2]),
    )


@njit(inline="always")
def project_block(points, V, lens, limits, splats):
    """Project a block of points to a block of splats. limits: width, height, near, blur."""
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    low_x, high_x, low_y, high_y = lens[4], lens[5], lens[6], lens[7]
    width, height, near, blur = limits
    for lane in range(LANES):
        X, Y, Z = _to_camera(V, points[lane], points[LANES + lane], points[2 * LANES + lane])
        ahead = near <= Z
        X, Y, Z = choose(ahead, X, ZERO), choose(ahead, Y, ZERO), choose(ahead, Z, ONE)
        w, x, y, z, _ = unit_quaternion(points, QUAT, lane)
        r00, r01, r02, r10, r11, r12, r20, r21, r22 = _rotation(w, x, y, z)
        s0, s1 = points[SCALE * LANES + lane], points[(SCALE + 1) * LANES + lane]
        s2 = points[(SCALE + 2) * LANES + lane]
        inverse_z = ONE / Z
        gx, gy = fx * inverse_z, fy * inverse_z
        u = min(max(X * inverse_z, low_x), high_x)
        v = min(max(Y * inverse_z, low_y), high_y)
        j0, j1, j2, k0, k1, k2 = _jacobian_rows(V, gx, gy, u, v)
        # The 2D covariance is [a; b] [a; b]^T, where a and b are the Jacobian's rows times rotation times scales.
        a0, b0 = (j0 * r00 + j1 * r10 + j2 * r20) * s0, (k0 * r00 + k1 * r10 + k2 * r20) * s0
        a1, b1 = (j0 * r01 + j1 * r11 + j2 * r21) * s1, (k0 * r01 + k1 * r11 + k2 * r21) * s1
        a2, b2 = (j0 * r02 + j1 * r12 + j2 * r22) * s2, (k0 * r02 + k1 * r12 + k2 * r22) * s2
        cxx = a0 * a0 + a1 * a1 + a2 * a2 + blur
        cyy = b0 * b0 + b1 * b1 + b2 * b2 + blur
        cxy = a0 * b0 + a1 * b1 + a2 * b2
        determinant = cxx * cyy - cxy * cxy
        px, py = gx * X + cx, gy * Y + cy
        rx, ry = np.ceil(EXTENT * math.sqrt(cxx)), np.ceil(EXTENT * math.sqrt(cyy))
        inside = (px + rx > ZERO) & (px - rx < width) & (py + ry > ZERO) & (py - ry < height)
        seen = ahead & (determinant > ZERO) & inside
        inverse = ONE / choose(determinant > ZERO, determinant, ONE)
        splats[lane] = choose(seen, px, ZERO)
        splats[LANES + lane] = choose(seen, py, ZERO)
        splats[CONIC * LANES + lane] = choose(seen, cyy * inverse, ZERO)
        splats[(CONIC + 1) * LANES + lane] = choose(seen, -cxy * inverse, ZERO)
        splats[(CONIC + 2) * LANES + lane] = choose(seen, cxx * inverse, ZERO)
        splats[DEPTH * LANES + lane] = choose(seen, Z, ZERO)
        splats[RADIUS * LANES + lane] = choose(seen, min(max(rx, ry), F(1e9)), ZERO)


@range_kernel(F2, F2, F2, F2, F1, LIMITS, F2, F2, F1, I1)
def _forward(first, last, means, quats, scales, V, lens, limits, means2d, conics, depths, radii):
    points, splats = stack_floats(POINT_FLOATS), stack_floats(SPLAT_FLOATS)
    for start in range(first, last, LANES):
        count = min(LANES, last - start)
        _load_points(means, quats, scales, start, count, points)
        project_block(points, V, lens, limits, splats)
        store_splats(splats, start, count, means2d, conics, depths, radii)


@njit(inline="always")
def _covariance_gradient(A, B, C, dA, half_dB, dC):
    """Return the gradient to (cxx, cxy, cyy) of the 2D covariance from the gradient dC to its inverse C: -C dC C."""
    t00, t01 = A * dA + B * half_dB, A * half_dB + B * dC
    t10, t11 = B * dA + C * half_dB, B * half_dB + C * dC
    return -(t00 * A + t01 * B), -TWO * (t00 * B + t01 * C), -(t10 * B + t11 * C)


@njit(inline="always")
def _quaternion_gradient(w, x, y, z, inverse, n00, n01, n02, n10, n11, n12, n20, n21, n22):
    """Return the gradient to the quaternion before normalization from the gradient to the rotation matrix."""
    qw = TWO * (x * (n21 - n12) + y * (n02 - n20) + z * (n10 - n01))
    qx = TWO * (-TWO * x * (n11 + n22) + y * (n10 + n01) + z * (n20 + n02) + w * (n21 - n12))
    qy = TWO * (x * (n10 + n01) - TWO * y * (n00 + n22) + z * (n21 + n12) + w * (n02 - n20))
    qz = TWO * (x * (n20 + n02) + y * (n21 + n12) - TWO * z * (n00 + n11) + w * (n10 - n01))
    along = qw * w + qx * x + qy * y + qz * z
    return (
        (qw - along * w) * inverse,
        (qx - along * x) * inverse,
        (qy - along * y) * inverse,
        (qz - along * z) * inverse,
    )


@njit(inline="always")
def load_splats(conics, d_means2d, d_conics, radii, start, count, splats, d_splats):
    """Load the inputs of `project_block_backward`: conics, radii, and the gradients to 2D means and conics."""
    load_rows(conics, start, count, 3, splats, CONIC)
    load_rows(d_means2d, start, count, 2, d_splats, MEAN2D)
    load_rows(d_conics, start, count, 3, d_splats, CONIC)
    for lane in range(LANES):
        splats[RADIUS * LANES + lane] = F(radii[start + min(lane, count - 1)])
        d_splats[DEPTH * LANES + lane] = ZERO


@njit(inline="always")
def project_block_backward(points, splats, d_splats, V, lens, d_points):
    """Compute the gradient to a block of points from that to their splats. splats: conics and radii. Culled points get zeros."""
    fx, fy, low_x, high_x, low_y, high_y = lens[0], lens[1], lens[4], lens[5], lens[6], lens[7]
    for lane in range(LANES):
        seen = splats[RADIUS * LANES + lane] > ZERO
        X, Y, Z = _to_camera(V, points[lane], points[LANES + lane], points[2 * LANES + lane])
        X, Y, Z = choose(seen, X, ZERO), choose(seen, Y, ZERO), choose(seen, Z, ONE)
        w, x, y, z, inverse_norm = unit_quaternion(points, QUAT, lane)
        r00, r01, r02, r10, r11, r12, r20, r21, r22 = _rotation(w, x, y, z)
        s0, s1 = points[SCALE * LANES + lane], points[(SCALE + 1) * LANES + lane]
        s2 = points[(SCALE + 2) * LANES + lane]
        inverse_z = ONE / Z
        gx, gy = fx * inverse_z, fy * inverse_z
        slope_x, slope_y = X * inverse_z, Y * inverse_z
        u, v = min(max(slope_x, low_x), high_x), min(max(slope_y, low_y), high_y)
        j0, j1, j2, k0, k1, k2 = _jacobian_rows(V, gx, gy, u, v)
        m00, m01, m02, m10, m11, m12 = r00 * s0, r01 * s1, r02 * s2, r10 * s0, r11 * s1, r12 * s2
        m20, m21, m22 = r20 * s0, r21 * s1, r22 * s2
        a0, a1, a2 = j0 * m00 + j1 * m10 + j2 * m20, j0 * m01 + j1 * m11 + j2 * m21, j0 * m02 + j1 * m12 + j2 * m22
        b0, b1, b2 = k0 * m00 + k1 * m10 + k2 * m20, k0 * m01 + k1 * m11 + k2 * m21, k0 * m02 + k1 * m12 + k2 * m22
        dxx, dxy, dyy = _covariance_gradient(
            splats[CONIC * LANES + lane],
            splats[(CONIC + 1) * LANES + lane],
            splats[(CONIC + 2) * LANES + lane],
            d_splats[CONIC * LANES + lane],
            HALF * d_splats[(CONIC + 1) * LANES + lane],
            d_splats[(CONIC + 2) * LANES + lane],
        )
        p0, p1, p2 = TWO * dxx * a0 + dxy * b0, TWO * dxx * a1 + dxy * b1, TWO * dxx * a2 + dxy * b2
        q0, q1, q2 = TWO * dyy * b0 + dxy * a0, TWO * dyy * b1 + dxy * a1, TWO * dyy * b2 + dxy * a2

        # The gradient through the Jacobian, whose rows are j = gx (V0 - u V2) and k = gy (V1 - v V2).
        dj0, dj1, dj2 = m00 * p0 + m01 * p1 + m02 * p2, m10 * p0 + m11 * p1 + m12 * p2, m20 * p0 + m21 * p1 + m22 * p2
        dk0, dk1, dk2 = m00 * q0 + m01 * q1 + m02 * q2, m10 * q0 + m11 * q1 + m12 * q2, m20 * q0 + m21 * q1 + m22 * q2
        j_along = V[2, 0] * dj0 + V[2, 1] * dj1 + V[2, 2] * dj2
        k_along = V[2, 0] * dk0 + V[2, 1] * dk1 + V[2, 2] * dk2
        dx, dy = d_splats[lane], d_splats[LANES + lane]
        d_gx = V[0, 0] * dj0 + V[0, 1] * dj1 + V[0, 2] * dj2 - u * j_along + X * dx
        d_gy = V[1, 0] * dk0 + V[1, 1] * dk1 + V[1, 2] * dk2 - v * k_along + Y * dy
        du, dv = -gx * j_along, -gy * k_along
        du = choose((low_x <= slope_x) & (slope_x <= high_x), du, ZERO)
        dv = choose((low_y <= slope_y) & (slope_y <= high_y), dv, ZERO)
        dX, dY = gx * dx + du * inverse_z, gy * dy + dv * inverse_z
        dZ = d_splats[DEPTH * LANES + lane] - inverse_z * (gx * d_gx + gy * d_gy + du * slope_x + dv * slope_y)
        mx = V[0, 0] * dX + V[1, 0] * dY + V[2, 0] * dZ
        my = V[0, 1] * dX + V[1, 1] * dY + V[2, 1] * dZ
        mz = V[0, 2] * dX + V[1, 2] * dY + V[2, 2] * dZ

        # The gradient through rotation times scales; n is the gradient to the product.
        n00, n01, n02 = j0 * p0 + k0 * q0, j0 * p1 + k0 * q1, j0 * p2 + k0 * q2
        n10, n11, n12 = j1 * p0 + k1 * q0, j1 * p1 + k1 * q1, j1 * p2 + k1 * q2
        n20, n21, n22 = j2 * p0 + k2 * q0, j2 * p1 + k2 * q1, j2 * p2 + k2 * q2
        sx, sy, sz = (
            r00 * n00 + r10 * n10 + r20 * n20,
            r01 * n01 + r11 * n11 + r21 * n21,
            r02 * n02 + r12 * n12 + r22 * n22,
        )
        n00, n10, n20, n01, n11, n21 = n00 * s0, n10 * s0, n20 * s0, n01 * s1, n11 * s1, n21 * s1
        qw, qx, qy, qz = _quaternion_gradient(
            w, x, y, z, inverse_norm, n00, n01, n02 * s2, n10, n11, n12 * s2, n20, n21, n22 * s2
        )
        d_points[lane] = choose(seen, mx, ZERO)
        d_points[LANES + lane] = choose(seen, my, ZERO)
        d_points[2 * LANES + lane] = choose(seen, mz, ZERO)
        d_points[QUAT * LANES + lane] = choose(seen, qw, ZERO)
        d_points[(QUAT + 1) * LANES + lane] = choose(seen, qx, ZERO)
        d_points[(QUAT + 2) * LANES + lane] = choose(seen, qy, ZERO)
        d_points[(QUAT + 3) * LANES + lane] = choose(seen, qz, ZERO)
        d_points[SCALE * LANES + lane] = choose(seen, sx, ZERO)
        d_points[(SCALE + 1) * LANES + lane] = choose(seen, sy, ZERO)
        d_points[(SCALE + 2) * LANES + lane] = choose(seen, sz, ZERO)


@range_kernel(F2, F2, F2, F2, F1, F2, I1, F2, F2, F1, F2, F2, F2)
def _backward(
    first, last, means, quats, scales, V, lens, conics, radii, d_means2d, d_conics, d_depths, d_means, d_quats, d_scales
):
    points, d_points = stack_floats(POINT_FLOATS), stack_floats(POINT_FLOATS)
    splats, d_splats = stack_floats(SPLAT_FLOATS), stack_floats(SPLAT_FLOATS)
    for start in range(first, last, LANES):
        count = min(LANES, last - start)
        _load_points(means, quats, scales, start, count, points)
        load_splats(conics, d_means2d, d_conics, radii, start, count, splats, d_splats)
        for lane in range(LANES):
            d_splats[DEPTH * LANES + lane] = d_depths[start + min(lane, count - 1)]
        project_block_backward(points, splats, d_splats, V, lens, d_points)
        store_rows(d_points, MEAN, start, count, 3, d_means)
        store_rows(d_points, QUAT, start, count, 4, d_quats)
        store_rows(d_points, SCALE, start, count, 3, d_scales)
