"""The photometric loss of 3DGS, (1 - lambda) L1 + lambda (1 - SSIM), and its gradient to the image in one go.

SSIM uses an 11 x 11 Gaussian window (sigma 1.5) with zeros outside the image. Rows are made one at a time: the window is
summed down the columns into a line that stays in the cache, then along the line. The two variances only appear summed,
so four blurs are enough: of x, y, x^2 + y^2 and xy.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from splatreel.kernels.cpu.jit import HALF, ONE, PARALLEL, TWO, ZERO, F, U

RADIUS = 5
TAPS = 2 * RADIUS + 1
_window = np.exp(-0.5 * (np.arange(TAPS) - RADIUS) ** 2 / 1.5**2)
WINDOW = (_window / _window.sum()).astype(np.float32)
SSIM_C1, SSIM_C2 = F(0.01**2), F(0.03**2)
PAD = 3 * RADIUS  # zeros either side of a line of interleaved RGB


def loss_and_gradient(image: np.ndarray, target: np.ndarray, lambda_dssim: float) -> tuple[float, np.ndarray]:
    """image, target: [H, W, 3] float32 in 0..1. Returns the loss and its gradient to image, [H, W, 3]."""
    height, width, _ = image.shape
    lines = (height, width * 3)
    x, y = image.reshape(lines), target.reshape(lines)
    maps = np.empty((3, *lines), np.float32)
    d_image = np.empty(lines, np.float32)
    similarity, differences = np.empty(height), np.empty(height)
    _ssim_maps(x, y, maps, similarity)
    l1_weight, ssim_weight = (1 - lambda_dssim) / image.size, lambda_dssim / image.size
    _gradient(x, y, maps, F(l1_weight), F(ssim_weight), d_image, differences)
    loss = l1_weight * differences.sum() + lambda_dssim - ssim_weight * similarity.sum()
    return float(loss), d_image.reshape(image.shape)


@njit(inline="always")
def _row_pair(source, zeros, row, k):
    """The rows k above and k below a row; `zeros` stands for those outside the image."""
    above = source[row - k] if row >= k else zeros
    below = source[row + k] if row + k < source.shape[0] else zeros
    return above, below


@njit(inline="always")
def _pair_weight(k):
    """Weight of the rows k away from the middle; the middle one is counted as both its own neighbours."""
    return WINDOW[RADIUS + k] * (HALF if k == 0 else ONE)


@njit(inline="always")
def _add_sum(line, weight, a, b):
    for j in range(U(a.shape[0])):
        line[U(PAD) + j] += weight * (a[j] + b[j])


@njit(inline="always")
def _add_squares(line, weight, xa, ya, xb, yb):
    for j in range(U(xa.shape[0])):
        line[U(PAD) + j] += weight * (xa[j] * xa[j] + ya[j] * ya[j] + xb[j] * xb[j] + yb[j] * yb[j])


@njit(inline="always")
def _add_products(line, weight, xa, ya, xb, yb):
    for j in range(U(xa.shape[0])):
        line[U(PAD) + j] += weight * (xa[j] * ya[j] + xb[j] * yb[j])


@njit(inline="always")
def _sum_along(line, out):
    """out = the window's sums along a padded line; pixels are 3 floats apart."""
    w0, w1, w2, w3, w4, w5 = WINDOW[0], WINDOW[1], WINDOW[2], WINDOW[3], WINDOW[4], WINDOW[5]
    for j in range(U(out.shape[0])):
        s = w0 * (line[j] + line[j + U(30)])
        s += w1 * (line[j + U(3)] + line[j + U(27)])
        s += w2 * (line[j + U(6)] + line[j + U(24)])
        s += w3 * (line[j + U(9)] + line[j + U(21)])
        s += w4 * (line[j + U(12)] + line[j + U(18)])
        out[j] = s + w5 * line[j + U(15)]


@njit(**PARALLEL)
def _ssim_maps(x, y, maps, similarity):
    """Sums SSIM over each row, and writes its gradient to the blurs of x, of x^2 + y^2 and of xy."""
    height, n = x.shape
    for row in prange(height):
        zeros = np.zeros(n, np.float32)
        lines = np.zeros((4, n + 2 * PAD), np.float32)
        for k in range(RADIUS + 1):
            weight = _pair_weight(k)
            xa, xb = _row_pair(x, zeros, row, k)
            ya, yb = _row_pair(y, zeros, row, k)
            _add_sum(lines[0], weight, xa, xb)
            _add_sum(lines[1], weight, ya, yb)
            _add_squares(lines[2], weight, xa, ya, xb, yb)
            _add_products(lines[3], weight, xa, ya, xb, yb)
        blurs = np.empty((4, n), np.float32)
        for k in range(4):
            _sum_along(lines[k], blurs[k])
        total = ZERO
        for j in range(n):
            mx, my = blurs[0, j], blurs[1, j]
            A, B = TWO * mx * my + SSIM_C1, TWO * (blurs[3, j] - mx * my) + SSIM_C2
            C, D = mx * mx + my * my + SSIM_C1, blurs[2, j] - mx * mx - my * my + SSIM_C2
            scale = ONE / (C * D)
            ssim = A * B * scale
            total += ssim
            d_squares, d_product = -ssim / D, TWO * A * scale
            maps[0, row, j] = TWO * my * B * scale - TWO * mx * ssim / C - TWO * mx * d_squares - my * d_product
            maps[1, row, j] = d_squares
            maps[2, row, j] = d_product
        similarity[row] = total


@njit(**PARALLEL)
def _gradient(x, y, maps, l1_weight, ssim_weight, d_image, differences):
    height, n = x.shape
    for row in prange(height):
        zeros = np.zeros(n, np.float32)
        lines = np.zeros((3, n + 2 * PAD), np.float32)
        blurs = np.empty((3, n), np.float32)
        for m in range(3):
            for k in range(RADIUS + 1):
                above, below = _row_pair(maps[m], zeros, row, k)
                _add_sum(lines[m], _pair_weight(k), above, below)
            _sum_along(lines[m], blurs[m])
        total = ZERO
        for j in range(n):
            difference = x[row, j] - y[row, j]
            total += abs(difference)
            sign = ONE if difference > ZERO else (-ONE if difference < ZERO else ZERO)
            ssim = blurs[0, j] + TWO * x[row, j] * blurs[1, j] + y[row, j] * blurs[2, j]
            d_image[row, j] = l1_weight * sign - ssim_weight * ssim
        differences[row] = total
