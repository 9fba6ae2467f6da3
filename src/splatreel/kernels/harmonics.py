"""Real spherical harmonics of degrees 0 to 3 in the 3DGS order and sign, forward and backward."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from splatreel.base.errors import GaussiansError
from splatreel.base.jit import BOOL, F1, F2, F3, INT, range_kernel
from splatreel.kernels.rows import stack_floats
from splatreel.kernels.scalars import HALF, ONE, ZERO, F

GRAIN = 512
"""Smallest number of points that is worth a thread."""

C0 = F(0.28209479177387814)
C1 = F(0.4886025119029199)
C2 = (
    F(1.0925484305920792),
    F(-1.0925484305920792),
    F(0.31539156525252005),
    F(-1.0925484305920792),
    F(0.5462742152960396),
)
C3 = (
    F(-0.5900435899266435),
    F(2.890611442640554),
    F(-0.4570457994644658),
    F(0.3731763325901154),
    F(-0.4570457994644658),
    F(1.445305721320277),
    F(-0.5900435899266435),
)


def forward(degree: int, directions: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Return the sum [N, 3] of the harmonics up to a degree in the 3DGS order, without the 0.5 of 3DGS colors.

    `directions` [N, 3] from the camera may have any length; `coefficients` are [N, K, 3].

    Raises:
        GaussiansError: There are too few coefficients for the degree.
    """
    if not 0 <= degree <= 3 or coefficients.shape[1] < (degree + 1) ** 2:
        raise GaussiansError(
            f"SH degree {degree} needs {(degree + 1) ** 2} coefficients, there are {coefficients.shape[1]}; choose 0..3."
        )
    colors = np.empty((len(directions), 3), np.float32)
    _forward.over(len(colors), (degree + 1) ** 2, directions, coefficients, colors, grain=GRAIN)
    return colors


def backward(
    degree: int, directions: np.ndarray, coefficients: np.ndarray, d_colors: np.ndarray, to_directions: bool
) -> tuple[np.ndarray | None, np.ndarray]:
    """Return the gradients to directions (None unless `to_directions`) and to coefficients."""
    d_directions, d_coefficients = np.zeros_like(directions), np.empty_like(coefficients)
    bands = (degree + 1) ** 2
    inputs = bands, directions, coefficients, d_colors, to_directions and bands > 1
    _backward.over(len(directions), *inputs, d_directions, d_coefficients, grain=GRAIN)
    return d_directions if to_directions else None, d_coefficients


def colors(means: np.ndarray, center: np.ndarray, base: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Return the colors [N, 3] of points seen from center [3]: 0.5 plus the harmonics, at least 0.

    base: [N, 1, 3]. rest: [N, K - 1, 3].
    """
    out = np.empty((len(means), 3), np.float32)
    _colors.over(len(means), means, center, base, rest, out, grain=GRAIN)
    return out


def colors_backward(
    means: np.ndarray, center: np.ndarray, seen: np.ndarray, rest: np.ndarray, d_colors: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the gradients to base and rest. seen: the colors that `colors` returned."""
    d_base, d_rest = np.empty((len(means), 1, 3), np.float32), np.empty_like(rest)
    _colors_backward.over(len(means), means, center, seen, d_colors, d_base, d_rest, grain=GRAIN)
    return d_base, d_rest


@njit(inline="always")
def _basis(bands, x, y, z, basis):
    """Write the first `bands` basis functions at a unit direction."""
    basis[0] = C0
    if bands > 1:
        basis[1], basis[2], basis[3] = -C1 * y, C1 * z, -C1 * x
    if bands > 4:
        basis[4] = C2[0] * x * y
        basis[5] = C2[1] * y * z
        basis[6] = C2[2] * (F(2) * z * z - x * x - y * y)
        basis[7] = C2[3] * x * z
        basis[8] = C2[4] * (x * x - y * y)
    if bands > 9:
        basis[9] = C3[0] * y * (F(3) * x * x - y * y)
        basis[10] = C3[1] * x * y * z
        basis[11] = C3[2] * y * (F(4) * z * z - x * x - y * y)
        basis[12] = C3[3] * z * (F(2) * z * z - F(3) * x * x - F(3) * y * y)
        basis[13] = C3[4] * x * (F(4) * z * z - x * x - y * y)
        basis[14] = C3[5] * z * (x * x - y * y)
        basis[15] = C3[6] * x * (x * x - F(3) * y * y)


@njit(inline="always")
def _direction_gradient(bands, x, y, z, g):
    """Return the sum over bands of g[k] times the gradient of basis function k, taken as a polynomial in x, y, z."""
    dx, dy, dz = -C1 * g[3], -C1 * g[1], C1 * g[2]
    if bands > 4:
        g4, g5, g6, g7, g8 = C2[0] * g[4], C2[1] * g[5], F(2) * C2[2] * g[6], C2[3] * g[7], F(2) * C2[4] * g[8]
        dx += g4 * y - g6 * x + g7 * z + g8 * x
        dy += g4 * x + g5 * z - g6 * y - g8 * y
        dz += g5 * y + F(2) * g6 * z + g7 * x
    if bands > 9:
        g9, g10, g11, g12 = C3[0] * g[9], C3[1] * g[10], C3[2] * g[11], C3[3] * g[12]
        g13, g14, g15 = C3[4] * g[13], C3[5] * g[14], C3[6] * g[15]
        xx, yy, zz, xy, yz, xz = x * x, y * y, z * z, x * y, y * z, x * z
        dx += F(6) * g9 * xy + g10 * yz - F(2) * g11 * xy - F(6) * g12 * xz
        dx += g13 * (F(4) * zz - F(3) * xx - yy) + F(2) * g14 * xz + g15 * F(3) * (xx - yy)
        dy += g9 * F(3) * (xx - yy) + g10 * xz + g11 * (F(4) * zz - xx - F(3) * yy) - F(6) * g12 * yz
        dy += -F(2) * g13 * xy - F(2) * g14 * yz - F(6) * g15 * xy
        dz += g10 * xy + F(8) * g11 * yz + g12 * (F(6) * zz - F(3) * xx - F(3) * yy)
        dz += F(8) * g13 * xz + g14 * (xx - yy)
    return dx, dy, dz


@range_kernel(INT, F2, F3, F2)
def _forward(first, last, bands, directions, coefficients, colors):
    for i in range(first, last):
        x, y, z = directions[i, 0], directions[i, 1], directions[i, 2]
        inverse = ONE / max(math.sqrt(x * x + y * y + z * z), F(1e-12))
        basis = stack_floats(16)
        _basis(bands, x * inverse, y * inverse, z * inverse, basis)
        r = g = b = ZERO
        for k in range(bands):
            r += basis[k] * coefficients[i, k, 0]
            g += basis[k] * coefficients[i, k, 1]
            b += basis[k] * coefficients[i, k, 2]
        colors[i, 0], colors[i, 1], colors[i, 2] = r, g, b


@range_kernel(INT, F2, F3, F2, BOOL, F2, F3)
def _backward(first, last, bands, directions, coefficients, d_colors, to_directions, d_directions, d_coefficients):
    for i in range(first, last):
        x, y, z = directions[i, 0], directions[i, 1], directions[i, 2]
        inverse = ONE / max(math.sqrt(x * x + y * y + z * z), F(1e-12))
        x, y, z = x * inverse, y * inverse, z * inverse
        basis = stack_floats(16)
        _basis(bands, x, y, z, basis)
        r, g, b = d_colors[i, 0], d_colors[i, 1], d_colors[i, 2]
        for k in range(coefficients.shape[1]):
            weight = basis[k] if k < bands else ZERO
            d_coefficients[i, k, 0], d_coefficients[i, k, 1], d_coefficients[i, k, 2] = (
                weight * r,
                weight * g,
                weight * b,
            )
        if to_directions:
            for k in range(bands):  # reuse the array of the basis for the gradient to each basis value
                basis[k] = r * coefficients[i, k, 0] + g * coefficients[i, k, 1] + b * coefficients[i, k, 2]
            dx, dy, dz = _direction_gradient(bands, x, y, z, basis)
            along = dx * x + dy * y + dz * z
            d_directions[i, 0] = (dx - along * x) * inverse
            d_directions[i, 1] = (dy - along * y) * inverse
            d_directions[i, 2] = (dz - along * z) * inverse


@njit(inline="always")
def _toward(means, center, i):
    """Return the unit direction from the camera to point i."""
    x, y, z = means[i, 0] - center[0], means[i, 1] - center[1], means[i, 2] - center[2]
    inverse = ONE / max(math.sqrt(x * x + y * y + z * z), F(1e-12))
    return x * inverse, y * inverse, z * inverse


@njit(inline="always")
def color_one(i, means, center, red, green, blue, rest, basis, colors):
    """Compute row i of `colors` from the base coefficients red, green and blue. basis: buffer [16]."""
    x, y, z = _toward(means, center, i)
    _basis(rest.shape[1] + 1, x, y, z, basis)
    red, green, blue = HALF + C0 * red, HALF + C0 * green, HALF + C0 * blue
    for k in range(rest.shape[1]):
        red += basis[k + 1] * rest[i, k, 0]
        green += basis[k + 1] * rest[i, k, 1]
        blue += basis[k + 1] * rest[i, k, 2]
    colors[i, 0], colors[i, 1], colors[i, 2] = max(red, ZERO), max(green, ZERO), max(blue, ZERO)


@njit(inline="always")
def color_one_backward(i, means, center, colors, d_colors, basis, d_base, d_rest):
    """Compute row i of `colors_backward`. basis: buffer [16]."""
    x, y, z = _toward(means, center, i)
    _basis(d_rest.shape[1] + 1, x, y, z, basis)
    r = d_colors[i, 0] if colors[i, 0] > ZERO else ZERO
    g = d_colors[i, 1] if colors[i, 1] > ZERO else ZERO
    b = d_colors[i, 2] if colors[i, 2] > ZERO else ZERO
    d_base[i, 0, 0], d_base[i, 0, 1], d_base[i, 0, 2] = C0 * r, C0 * g, C0 * b
    for k in range(d_rest.shape[1]):
        weight = basis[k + 1]
        d_rest[i, k, 0], d_rest[i, k, 1], d_rest[i, k, 2] = weight * r, weight * g, weight * b


@range_kernel(F2, F1, F3, F3, F2)
def _colors(first, last, means, center, base, rest, colors):
    for i in range(first, last):
        basis = stack_floats(16)
        color_one(i, means, center, base[i, 0, 0], base[i, 0, 1], base[i, 0, 2], rest, basis, colors)


@range_kernel(F2, F1, F2, F2, F3, F3)
def _colors_backward(first, last, means, center, colors, d_colors, d_base, d_rest):
    for i in range(first, last):
        basis = stack_floats(16)
        color_one_backward(i, means, center, colors, d_colors, basis, d_base, d_rest)
