"""The photometric loss of 3DGS, (1 - lambda) L1 + lambda (1 - SSIM), and its gradient to the image in one go.

SSIM uses an 11 x 11 Gaussian window (sigma 1.5) with zeros outside the image. Rows are processed one at a time: the window's
columns are summed into a line that stays in the cache, then the window's rows along it.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from splatreel.kernels.cpu.jit import ONE, PARALLEL, TWO, ZERO, F, U

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
    maps = np.empty((3, *lines), np.float32)  # gradient of the summed SSIM to the blurs of x, x^2 and xy
    d_image = np.empty(lines, np.float32)
    similarity, differences = np.empty(height), np.empty(height)
    _ssim_maps(x, y, maps, similarity)
    l1_weight, ssim_weight = (1 - lambda_dssim) / image.size, lambda_dssim / image.size
    _gradient(x, y, maps, F(l1_weight), F(ssim_weight), d_image, differences)
    loss = l1_weight * differences.sum() + lambda_dssim - ssim_weight * similarity.sum()
    return float(loss), d_image.reshape(image.shape)


@njit(inline="always")
def _column_sum(source, row, line):
    """line[PAD:] = the window's column sums of source about a row."""
    n = U(source.shape[1])
    for j in range(U(PAD), U(PAD) + n):
        line[j] = ZERO
    for k in range(max(0, RADIUS - row), min(TAPS, source.shape[0] + RADIUS - row)):
        weight, values = WINDOW[k], source[row + k - RADIUS]
        for j in range(n):
            line[U(PAD) + j] += weight * values[j]


@njit(inline="always")
def _column_sum_product(source, other, row, line):
    """line[PAD:] = the window's column sums of source * other about a row."""
    n = U(source.shape[1])
    for j in range(U(PAD), U(PAD) + n):
        line[j] = ZERO
    for k in range(max(0, RADIUS - row), min(TAPS, source.shape[0] + RADIUS - row)):
        weight, values, factors = WINDOW[k], source[row + k - RADIUS], other[row + k - RADIUS]
        for j in range(n):
            line[U(PAD) + j] += weight * values[j] * factors[j]


@njit(inline="always")
def _row_sum(line, out):
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
    height, n = x.shape
    for row in prange(height):
        line = np.zeros(n + 2 * PAD, np.float32)
        blurs = np.empty((5, n), np.float32)
        _column_sum(x, row, line)
        _row_sum(line, blurs[0])
        _column_sum(y, row, line)
        _row_sum(line, blurs[1])
        _column_sum_product(x, x, row, line)
        _row_sum(line, blurs[2])
        _column_sum_product(y, y, row, line)
        _row_sum(line, blurs[3])
        _column_sum_product(x, y, row, line)
        _row_sum(line, blurs[4])
        total = 0.0
        for j in range(n):
            mx, my = blurs[0, j], blurs[1, j]
            vx, vy, cov = blurs[2, j] - mx * mx, blurs[3, j] - my * my, blurs[4, j] - mx * my
            A, B = TWO * mx * my + SSIM_C1, TWO * cov + SSIM_C2
            C, D = mx * mx + my * my + SSIM_C1, vx + vy + SSIM_C2
            scale = ONE / (C * D)
            ssim = A * B * scale
            total += ssim
            d_xx, d_xy = -ssim / D, TWO * A * scale
            maps[0, row, j] = TWO * my * B * scale - TWO * mx * ssim / C - TWO * mx * d_xx - my * d_xy
            maps[1, row, j] = d_xx
            maps[2, row, j] = d_xy
        similarity[row] = total


@njit(**PARALLEL)
def _gradient(x, y, maps, l1_weight, ssim_weight, d_image, differences):
    height, n = x.shape
    for row in prange(height):
        line = np.zeros(n + 2 * PAD, np.float32)
        blurs = np.empty((3, n), np.float32)
        for k in range(3):
            _column_sum(maps[k], row, line)
            _row_sum(line, blurs[k])
        total = 0.0
        for j in range(n):
            difference = x[row, j] - y[row, j]
            total += abs(difference)
            sign = ONE if difference > ZERO else (-ONE if difference < ZERO else ZERO)
            ssim = blurs[0, j] + TWO * x[row, j] * blurs[1, j] + y[row, j] * blurs[2, j]
            d_image[row, j] = l1_weight * sign - ssim_weight * ssim
        differences[row] = total
