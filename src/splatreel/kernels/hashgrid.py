"""A multiresolution hash grid (Instant-NGP) with trilinear interpolation.

One task per level avoids races, and the table of the level stays in the cache.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from splatreel.base.errors import GaussiansError
from splatreel.base.jit import B1, F2, F3, array, range_kernel
from splatreel.kernels.scalars import ONE, ZERO, F

GRIDS = array(np.uint32, 2)
GRAIN = 512
"""Smallest number of points that is worth a thread."""

PRIME_Y, PRIME_Z = np.uint32(2654435761), np.uint32(805459861)


def forward(coords: np.ndarray, table: np.ndarray, resolutions: np.ndarray) -> np.ndarray:
    """Return trilinear features [N, L * F] of every level of a multiresolution hash grid.

    A level whose corners fit into T rows is stored densely. Other levels are hashed. `coords` [N, 3] are clamped to
    0..1. `table` is [L, T, F], T a power of two. `resolutions` [L, 3] are cells along each axis.

    Raises:
        GaussiansError: The shapes do not fit.

    Source:
        Instant-NGP, section 3.
    """
    levels, size, features = table.shape
    if resolutions.shape != (levels, 3) or resolutions.min() < 1 or size & (size - 1):
        raise GaussiansError(
            f"hashgrid: table {table.shape} and resolutions {resolutions.shape}, least {resolutions.min()}, do not fit; "
            "they must be [L, T, F], T a power of two, and [L, 3], at least 1."
        )
    out = np.empty((len(coords), levels * features), np.float32)
    _forward.over(levels, coords, table, resolutions.astype(np.uint32), is_dense(resolutions, size), out)
    return out


def table_gradient(coords: np.ndarray, table: np.ndarray, d_out: np.ndarray, resolutions: np.ndarray) -> np.ndarray:
    """Return the gradient [L, T, F] to the table."""
    d_table = np.zeros_like(table)
    dense = is_dense(resolutions, table.shape[1])
    _table_gradient.over(len(table), coords, resolutions.astype(np.uint32), dense, d_out, d_table)
    return d_table


def coords_gradient(coords: np.ndarray, table: np.ndarray, d_out: np.ndarray, resolutions: np.ndarray) -> np.ndarray:
    """Return the gradient [N, 3] to the coordinates. It is zero along axes on which the point was clamped."""
    d_coords = np.empty_like(coords)
    dense = is_dense(resolutions, table.shape[1])
    inputs = coords, table, resolutions.astype(np.uint32), dense, d_out
    _coords_gradient.over(len(coords), *inputs, d_coords, grain=GRAIN)
    return d_coords


def is_dense(resolutions: np.ndarray, size: int) -> np.ndarray:
    """Return [L] bool: whether all corners of a level fit into the table, so that the level needs no hash."""
    return np.array([math.prod(int(r) + 1 for r in level) <= size for level in resolutions])


@njit(inline="always")
def _cell(coord, resolution):
    """Return the cell of a coordinate in 0..1 and the fraction within the cell. The coordinate 1 belongs to the last cell."""
    position = min(max(coord, ZERO), ONE) * F(resolution)
    cell = min(np.uint32(position), np.uint32(resolution - np.uint32(1)))
    return cell, position - F(cell)


@njit(inline="always")
def _row(x, y, z, resolution, dense, size):
    """Return the table row of a corner: in order, x fastest, if dense, else the hash of Instant-NGP. size: a power of two."""
    if dense:
        return x + (resolution[0] + np.uint32(1)) * (y + (resolution[1] + np.uint32(1)) * z)
    return (x ^ (y * PRIME_Y) ^ (z * PRIME_Z)) & np.uint32(size - 1)


@njit(inline="always")
def _corners(coords, i, resolution, dense, size, rows, weights):
    """Write the table rows and trilinear weights of the 8 corners around point i."""
    x, fx = _cell(coords[i, 0], resolution[0])
    y, fy = _cell(coords[i, 1], resolution[1])
    z, fz = _cell(coords[i, 2], resolution[2])
    for corner in range(8):
        bx, by, bz = np.uint32(corner & 1), np.uint32((corner >> 1) & 1), np.uint32(corner >> 2)
        rows[corner] = _row(np.uint32(x + bx), np.uint32(y + by), np.uint32(z + bz), resolution, dense, size)
        weights[corner] = (fx if bx else ONE - fx) * (fy if by else ONE - fy) * (fz if bz else ONE - fz)


@range_kernel(F2, F3, GRIDS, B1, F2, allocates=True)
def _forward(first, last, coords, table, resolutions, dense, out):
    _, size, features = table.shape
    for level in range(first, last):
        values, resolution, is_dense = table[level], resolutions[level], dense[level]
        rows, weights = np.empty(8, np.uint32), np.empty(8, np.float32)
        for i in range(coords.shape[0]):
            _corners(coords, i, resolution, is_dense, size, rows, weights)
            for f in range(features):
                total = ZERO
                for corner in range(8):
                    total += weights[corner] * values[rows[corner], f]
                out[i, level * features + f] = total


@range_kernel(F2, GRIDS, B1, F2, F3, allocates=True)
def _table_gradient(first, last, coords, resolutions, dense, d_out, d_table):
    _, size, features = d_table.shape
    for level in range(first, last):
        d_values, resolution, is_dense = d_table[level], resolutions[level], dense[level]
        rows, weights = np.empty(8, np.uint32), np.empty(8, np.float32)
        for i in range(coords.shape[0]):
            _corners(coords, i, resolution, is_dense, size, rows, weights)
            for f in range(features):
                gradient = d_out[i, level * features + f]
                for corner in range(8):
                    d_values[rows[corner], f] += weights[corner] * gradient


@range_kernel(F2, F3, GRIDS, B1, F2, F2, allocates=True)
def _coords_gradient(first, last, coords, table, resolutions, dense, d_out, d_coords):
    """Compute the gradient to the coordinates. One task per point sums the levels in order."""
    levels, size, features = table.shape
    for i in range(first, last):
        gx = gy = gz = ZERO
        for level in range(levels):
            resolution, is_dense = resolutions[level], dense[level]
            x, fx = _cell(coords[i, 0], resolution[0])
            y, fy = _cell(coords[i, 1], resolution[1])
            z, fz = _cell(coords[i, 2], resolution[2])
            for corner in range(8):
                bx, by, bz = np.uint32(corner & 1), np.uint32((corner >> 1) & 1), np.uint32(corner >> 2)
                row = _row(np.uint32(x + bx), np.uint32(y + by), np.uint32(z + bz), resolution, is_dense, size)
                value = ZERO
                for f in range(features):
                    value += d_out[i, level * features + f] * table[level, row, f]
                wx, wy, wz = fx if bx else ONE - fx, fy if by else ONE - fy, fz if bz else ONE - fz
                gx += (value if bx else -value) * wy * wz * F(resolution[0])
                gy += (value if by else -value) * wx * wz * F(resolution[1])
                gz += (value if bz else -value) * wx * wy * F(resolution[2])
        d_coords[i, 0] = gx if ZERO <= coords[i, 0] <= ONE else ZERO
        d_coords[i, 1] = gy if ZERO <= coords[i, 1] <= ONE else ZERO
        d_coords[i, 2] = gz if ZERO <= coords[i, 2] <= ONE else ZERO
