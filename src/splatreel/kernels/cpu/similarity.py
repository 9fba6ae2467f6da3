"""The photometric loss of 3DGS, (1 - lambda) L1 + lambda (1 - SSIM), and its gradient to the image in one go.

SSIM uses an 11 x 11 Gaussian window (sigma 1.5) with zeros outside the image. The two variances only appear summed, so four
blurs are enough: of x, y, x^2 + y^2 and xy. One task does a block of 16 rows and 80 pixels, copied with its border into
planes of a constant row stride that stay in the cache: the window is then a sum at constant offsets, which LLVM turns into
vector code (unsigned indices, see `rasterize`).
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from splatreel.kernels.cpu.jit import ONE, PARALLEL, TWO, ZERO, F, U

RADIUS = 5
_window = np.exp(-0.5 * (np.arange(2 * RADIUS + 1) - RADIUS) ** 2 / 1.5**2)
WINDOW = (_window / _window.sum()).astype(np.float32)
W0, W1, W2, W3, W4, W5 = WINDOW[:6]  # it is symmetric
SSIM_C1, SSIM_C2 = F(0.01**2), F(0.03**2)

ROWS, COLUMNS = 16, 240  # of a block; columns are floats, three a pixel
BORDER = 3 * RADIUS
STRIDE = 272  # >= COLUMNS + 2 * BORDER, and whole cache lines
AREA = ROWS * STRIDE
PADDED = (ROWS + 2 * RADIUS) * STRIDE


def loss_and_gradient(image: np.ndarray, target: np.ndarray, lambda_dssim: float) -> tuple[float, np.ndarray]:
    """image, target: [H, W, 3] float32 in 0..1. Returns the loss and its gradient to image, [H, W, 3]."""
    height, width, _ = image.shape
    lines = (height, width * 3)
    x, y = image.reshape(lines), target.reshape(lines)
    maps, d_image = np.empty((3, *lines), np.float32), np.empty(lines, np.float32)
    blocks = -(-height // ROWS) * -(-lines[1] // COLUMNS)
    similarity, differences = np.empty(blocks, np.float32), np.empty(blocks, np.float32)
    _ssim_maps(x, y, maps, similarity)
    l1_weight, ssim_weight = (1 - lambda_dssim) / image.size, lambda_dssim / image.size
    _gradient(x, y, maps, F(l1_weight), F(ssim_weight), d_image, differences)
    l1, ssim = differences.sum(dtype=np.float64), similarity.sum(dtype=np.float64)
    return float(l1_weight * l1 + lambda_dssim - ssim_weight * ssim), d_image.reshape(image.shape)


@njit(inline="always")
def _block(index, shape):
    """First row and column of a block, and how many of its rows and columns lie in the image."""
    across = (shape[1] + COLUMNS - 1) // COLUMNS
    top, left = index // across * ROWS, index % across * COLUMNS
    return top, left, min(ROWS, shape[0] - top), min(COLUMNS, shape[1] - left)


@njit(inline="always")
def _load(image, top, left, plane):
    """Copies a block and its border into a plane, zeros outside the image."""
    first, last = max(left - BORDER, 0), min(left + COLUMNS + BORDER, image.shape[1])
    plane[:] = ZERO
    for row in range(max(top - RADIUS, 0), min(top + ROWS + RADIUS, image.shape[0])):
        start = (row - top + RADIUS) * STRIDE + first - left + BORDER
        line, source = plane[start : start + last - first], image[row, first:last]
        for j in range(U(last - first)):
            line[j] = source[j]


@njit(inline="always")
def _blur(plane, down, out):
    """The window's sums over a plane: down the columns, then along the rows, where pixels are 3 floats apart."""
    for p in range(U(AREA)):
        s = W0 * (plane[p] + plane[p + U(10 * STRIDE)])
        s += W1 * (plane[p + U(STRIDE)] + plane[p + U(9 * STRIDE)])
        s += W2 * (plane[p + U(2 * STRIDE)] + plane[p + U(8 * STRIDE)])
        s += W3 * (plane[p + U(3 * STRIDE)] + plane[p + U(7 * STRIDE)])
        s += W4 * (plane[p + U(4 * STRIDE)] + plane[p + U(6 * STRIDE)])
        down[p] = s + W5 * plane[p + U(5 * STRIDE)]
    for p in range(U(AREA - 2 * BORDER)):
        s = W0 * (down[p] + down[p + U(30)])
        s += W1 * (down[p + U(3)] + down[p + U(27)])
        s += W2 * (down[p + U(6)] + down[p + U(24)])
        s += W3 * (down[p + U(9)] + down[p + U(21)])
        s += W4 * (down[p + U(12)] + down[p + U(18)])
        out[p] = s + W5 * down[p + U(15)]


@njit(inline="always")
def _ssim_row(blurs, start, columns):
    """Sum of SSIM along a row of a block; the blurs become its gradient to those of x, x^2 + y^2 and xy."""
    total = ZERO
    for p in range(U(start), U(start + columns)):
        mx, my = blurs[p], blurs[p + U(AREA)]
        A, B = TWO * mx * my + SSIM_C1, TWO * (blurs[p + U(3 * AREA)] - mx * my) + SSIM_C2
        C, D = mx * mx + my * my + SSIM_C1, blurs[p + U(2 * AREA)] - mx * mx - my * my + SSIM_C2
        scale = ONE / (C * D)
        ssim = A * B * scale
        total += ssim
        d_squares, d_product = -ssim * scale * C, TWO * A * scale
        blurs[p] = TWO * my * B * scale - TWO * mx * (ssim * scale * D + d_squares) - my * d_product
        blurs[p + U(AREA)] = d_squares
        blurs[p + U(2 * AREA)] = d_product
    return total


@njit(**PARALLEL)
def _ssim_maps(x, y, maps, similarity):
    for block in prange(similarity.shape[0]):
        top, left, rows, columns = _block(block, x.shape)
        plane_x, plane_y = np.empty(PADDED, np.float32), np.empty(PADDED, np.float32)
        mixed, down = np.empty(PADDED, np.float32), np.empty(AREA, np.float32)
        blurs = np.empty(4 * AREA, np.float32)
        _load(x, top, left, plane_x)
        _load(y, top, left, plane_y)
        _blur(plane_x, down, blurs[:AREA])
        _blur(plane_y, down, blurs[AREA : 2 * AREA])
        for p in range(U(PADDED)):
            mixed[p] = plane_x[p] * plane_x[p] + plane_y[p] * plane_y[p]
        _blur(mixed, down, blurs[2 * AREA : 3 * AREA])
        for p in range(U(PADDED)):
            mixed[p] = plane_x[p] * plane_y[p]
        _blur(mixed, down, blurs[3 * AREA :])
        total = ZERO
        for r in range(rows):
            total += _ssim_row(blurs, r * STRIDE, columns)
            for m in range(3):
                start = m * AREA + r * STRIDE
                maps[m, top + r, left : left + columns] = blurs[start : start + columns]
        similarity[block] = total


@njit(**PARALLEL)
def _gradient(x, y, maps, l1_weight, ssim_weight, d_image, differences):
    for block in prange(differences.shape[0]):
        top, left, rows, columns = _block(block, x.shape)
        plane, down = np.empty(PADDED, np.float32), np.empty(AREA, np.float32)
        blurs = np.empty(3 * AREA, np.float32)
        for m in range(3):
            _load(maps[m], top, left, plane)
            _blur(plane, down, blurs[m * AREA : (m + 1) * AREA])
        total = ZERO
        for r in range(rows):
            row_x, row_y = x[top + r, left : left + columns], y[top + r, left : left + columns]
            d_row, parts = d_image[top + r, left : left + columns], blurs[r * STRIDE :]
            for p in range(U(columns)):
                difference = row_x[p] - row_y[p]
                total += abs(difference)
                sign = ONE if difference > ZERO else (-ONE if difference < ZERO else ZERO)
                ssim = parts[p] + TWO * row_x[p] * parts[p + U(AREA)] + row_y[p] * parts[p + U(2 * AREA)]
                d_row[p] = l1_weight * sign - ssim_weight * ssim
        differences[block] = total
