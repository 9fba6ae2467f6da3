"""The photometric loss of 3DGS, (1 - lambda) L1 + lambda (1 - SSIM), and its gradient to the image.

SSIM uses an 11 x 11 Gaussian window (sigma 1.5) with zeros outside the image. The two variances only appear as a sum, so four blurs are
enough: of x, y, x^2 + y^2 and xy. One task computes a block of 16 rows and 80 pixels. The block and its border are copied into planes
with a constant row stride, which stay in the cache. The window is then a sum at constant offsets, which LLVM turns into vector code
(for the unsigned indices see `scalars`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numba import njit, types

from splatreel.base.errors import GaussiansError
from splatreel.base.jit import B1, B2, F1, F2, F3, F4, FLOAT, L1, U2, Kernel, kernel, range_kernel
from splatreel.kernels import rasterize
from splatreel.kernels.binning import TILE, Bins, tiles_of
from splatreel.kernels.scalars import ONE, TWO, ZERO, F, U

RADIUS = 5
_window = np.exp(-0.5 * (np.arange(2 * RADIUS + 1) - RADIUS) ** 2 / 1.5**2)
WINDOW = (_window / _window.sum()).astype(np.float32)
W0, W1, W2, W3, W4, W5 = WINDOW[:6]  # the window is symmetric
SSIM_C1, SSIM_C2 = F(0.01**2), F(0.03**2)

ROWS, TILES = 16, 5
"""Rows of pixels in a block, and tiles of 16 x 16 pixels side by side."""
COLUMNS = 3 * 16 * TILES
"""Floats in a row of a block, three per pixel."""
BORDER = 3 * RADIUS
STRIDE = 272  # at least COLUMNS + 2 * BORDER, and a multiple of the cache line
AREA = ROWS * STRIDE
PADDED = (ROWS + 2 * RADIUS) * STRIDE


@dataclass(frozen=True)
class Gradient:
    """Loss and its gradients, see `loss_and_gradient`.

    d_image: [H, W, 3]. d_gain: [3], a sum over the blocks with a wanted tile.
    """

    loss: float
    d_image: np.ndarray
    d_gain: np.ndarray


def loss_and_gradient(
    image: np.ndarray,
    target: np.ndarray,
    lambda_dssim: float,
    gain: np.ndarray | None = None,
    tiles: np.ndarray | None = None,
    background: np.ndarray | None = None,
    zeros: bool = True,
) -> Gradient:
    """Return the loss of (image + background) * gain against the target, and its gradient.

    Only gradients of `tiles` [ceil(H / 16), ceil(W / 16)] bool are wanted: the loss leaves out the terms that do not
    depend on them, which are a constant, and the gradient elsewhere is undefined unless `zeros`. The target is [H, W,
    3] float32, 0..1, or uint8. `gain` and `background` are [3].

    Raises:
        GaussiansError: The shapes do not fit.

    Source:
        3D Gaussian Splatting, section 5.1.
    """
    if image.shape != target.shape or image.shape[-1] != 3:
        raise GaussiansError(
            f"The photometric loss of an image {image.shape} and a target {target.shape}: both must be [H, W, 3]."
        )
    height, width, _ = image.shape
    lines = (height, width * 3)
    x, y = image.reshape(lines), target.reshape(lines)
    scale = F(1 / 255) if target.dtype == np.uint8 else ONE
    gains = np.tile(np.ones(3, np.float32) if gain is None else gain, width)
    behind = np.tile(np.zeros(3, np.float32) if background is None else background, width)
    rows, across = -(-height // ROWS), -(-lines[1] // COLUMNS)
    drawn = np.zeros((rows, across * TILES), np.bool_)
    drawn[:, : -(-width // ROWS)] = True if tiles is None else tiles
    changed, compared = _blocks(drawn)
    # Blocks that are not compared stay unset, since no wanted gradient depends on them.
    maps = np.empty((3, *lines), np.float32)
    d_image = np.zeros(lines, np.float32) if zeros and tiles is not None else np.empty(lines, np.float32)
    similarity, differences = np.empty(len(compared), np.float32), np.empty(len(changed), np.float32)
    products = np.zeros((len(changed), COLUMNS), np.float32)
    ssim_maps, gradient = (_ssim_maps_u8, _gradient_u8) if y.dtype == np.uint8 else _OF_FLOATS
    seen = (x, y, behind, gains, np.ones_like(gains), np.zeros_like(gains), scale)
    ssim_maps.over(len(compared), *seen, compared, maps, similarity)
    l1_weight, ssim_weight = (1 - lambda_dssim) / image.size, lambda_dssim / image.size
    weights = F(l1_weight), F(ssim_weight)
    found = d_image, differences, products
    gradient.over(len(changed), *seen, changed, drawn.reshape(-1), maps, *weights, *found)
    l1, ssim = differences.sum(dtype=np.float64), similarity.sum(dtype=np.float64)
    loss = float(l1_weight * l1 + lambda_dssim - ssim_weight * ssim)
    d_gain = products.reshape(-1, 3).sum(0, dtype=np.float64).astype(np.float32)
    return Gradient(loss, d_image.reshape(image.shape), d_gain)


@kernel(B2)
def _blocks(tiles):
    """Return the blocks that contain any of the tiles, and the blocks that contain any of the tiles or their neighbors.

    The neighbors count because the window reaches five pixels over a tile's border.
    """
    rows, across = tiles.shape[0], tiles.shape[1] // TILES
    holds, near = np.zeros(rows * across, np.bool_), np.zeros(rows * across, np.bool_)
    for row in range(rows):
        for column in range(tiles.shape[1]):
            if tiles[row, column]:
                holds[row * across + column // TILES] = True
                for r in range(max(row - 1, 0), min(row + 2, rows)):
                    for c in range(max(column - 1, 0), min(column + 2, tiles.shape[1])):
                        near[r * across + c // TILES] = True
    return np.flatnonzero(holds), np.flatnonzero(near)


@njit(inline="always")
def _block(index, shape):
    """Return the first row and column of a block, and the number of its rows and columns in the image."""
    across = (shape[1] + COLUMNS - 1) // COLUMNS
    top, left = index // across * ROWS, index % across * COLUMNS
    return top, left, min(ROWS, shape[0] - top), min(COLUMNS, shape[1] - left)


@njit(inline="always")
def _load(image, top, left, behind, gains, scale, plane):
    """Copy (block + behind) * gains * scale with its border into a plane, zeros outside the image. behind, gains: [columns]."""
    first, last = max(left - BORDER, 0), min(left + COLUMNS + BORDER, image.shape[1])
    plane[:] = ZERO
    for row in range(max(top - RADIUS, 0), min(top + ROWS + RADIUS, image.shape[0])):
        start = (row - top + RADIUS) * STRIDE + first - left + BORDER
        line, source = plane[start : start + last - first], image[row, first:last]
        added, factors = behind[first:last], gains[first:last]
        for j in range(U(last - first)):
            line[j] = (F(source[j]) + added[j]) * (factors[j] * scale)


@njit(inline="always")
def _blur(plane, down, out):
    """Blur a plane with the window: down the columns, then along the rows, where pixels are 3 floats apart."""
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
    """Return the sum of SSIM along a row of a block. Its gradients to the blurs of x, x^2 + y^2 and xy replace the blurs."""
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


def _ssim_maps(begin, end, x, y, behind, gains, ones, none, scale, blocks, maps, similarity):
    plane_x, plane_y = np.empty(PADDED, np.float32), np.empty(PADDED, np.float32)
    mixed, down = np.empty(PADDED, np.float32), np.empty(AREA, np.float32)
    blurs = np.empty(4 * AREA, np.float32)
    for task in range(begin, end):
        top, left, rows, columns = _block(blocks[task], x.shape)
        _load(x, top, left, behind, gains, ONE, plane_x)
        _load(y, top, left, none, ones, scale, plane_y)
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
        similarity[task] = total


def _gradient(
    begin,
    end,
    x,
    y,
    behind,
    gains,
    ones,
    none,
    scale,
    blocks,
    drawn,
    maps,
    l1_weight,
    ssim_weight,
    d_image,
    differences,
    products,
):
    plane, down = np.empty(PADDED, np.float32), np.empty(AREA, np.float32)
    blurs = np.empty(3 * AREA, np.float32)
    for task in range(begin, end):
        top, left, rows, columns = _block(blocks[task], x.shape)
        for m in range(3):
            _load(maps[m], top, left, none, ones, ONE, plane)
            _blur(plane, down, blurs[m * AREA : (m + 1) * AREA])
        total = ZERO
        for r in range(rows):
            row_x, row_y = x[top + r, left : left + columns], y[top + r, left : left + columns]
            d_row, parts, factors = d_image[top + r, left : left + columns], blurs[r * STRIDE :], gains[left:]
            sums, added = products[task], behind[left:]
            for p in range(U(columns)):
                plain = row_x[p] + added[p]
                seen, wanted = plain * factors[p], F(row_y[p]) * scale
                difference = seen - wanted
                total += abs(difference)
                sign = ONE if difference > ZERO else (-ONE if difference < ZERO else ZERO)
                ssim = parts[p] + TWO * seen * parts[p + U(AREA)] + wanted * parts[p + U(2 * AREA)]
                slope = l1_weight * sign - ssim_weight * ssim
                d_row[p] = slope * factors[p]
                sums[p] += slope * plain
        differences[task] = total
        for tile in range(TILES):
            if not drawn[blocks[task] * TILES + tile]:
                d_image[top : top + rows, left + 3 * ROWS * tile : left + 3 * ROWS * (tile + 1)] = ZERO


def _kernels(target: types.Array) -> tuple[Kernel, Kernel]:
    """Return the kernels of the forward and the backward pass for one type of target."""
    maps, gradient = (L1, F3, F1), (L1, B1, F3, FLOAT, FLOAT, F2, F1, F2)
    return _kernel(_ssim_maps, target, *maps), _kernel(_gradient, target, *gradient)


def _kernel(function: Callable[..., None], target: types.Array, *rest: types.Type) -> Kernel:
    """Return a kernel for one type of target."""
    name = f"{function.__name__.strip('_')}_{target.dtype}"
    return range_kernel(F2, target, F1, F1, F1, F1, FLOAT, *rest, allocates=True, name=name)(function)


_ssim_maps_u8, _gradient_u8 = _kernels(U2)
_OF_FLOATS = _kernels(F2)
"""Not compiled ahead of time, since training images are bytes."""


GRAIN = 64
"""Smallest number of tiles that is worth a thread."""


def loss_and_gradient_among(
    bins: Bins,
    colors: np.ndarray,
    frozen: rasterize.Frozen,
    target: np.ndarray,
    lambda_dssim: float,
    gain: np.ndarray | None,
    background: np.ndarray | None,
    where: np.ndarray | None = None,
    whole: bool = False,
    unknown: np.ndarray | None = None,
) -> tuple[float, rasterize.Gradients]:
    """Return the loss of (image + background) * gain against the target, see `loss_and_gradient`, and its gradients.

    There is no pass over the whole image: if a tenth of a megapixel image changes, copying and clearing the unchanged rest
    would take longer than everything else. The splats are drawn into the image of the frozen splats, which is restored
    afterwards. So two threads must not use the same frozen splats at once. With `where` [N] bool, `bins` has all splats of
    the view, the frozen ones too, and only tiles that a splat of `where` touches are drawn and compared. Unless the loss is
    that of the `whole` image, it leaves out a constant. Pixels of `unknown` [H, W] cause no loss; the target is uint8 then.
    """
    tiles = bins.counts > 0 if where is None else tiles_of(bins, where)
    among = frozen if where is None else None
    with _put_back(frozen, np.flatnonzero(tiles)):
        rasterize.draw_over(bins, colors, frozen, among, tiles)
        compared = None if whole else tiles.reshape(-(-bins.height // TILE), -1)
        if unknown is not None:
            target = _with_drawing(target, unknown, frozen.image, gain, background)
        found = loss_and_gradient(frozen.image, target, lambda_dssim, gain, compared, background, zeros=False)
        none = rasterize.no_gradient(frozen.alpha.shape)
        arguments = bins, colors, frozen.image, found.d_image, frozen.alpha, none, among
        gradients = rasterize.backward(*arguments, wanted=None if where is None else tiles)
    return found.loss, gradients


def _with_drawing(
    target: np.ndarray, unknown: np.ndarray, image: np.ndarray, gain: np.ndarray | None, background: np.ndarray | None
) -> np.ndarray:
    """Return a target [H, W, 3] uint8 whose unknown pixels [H, W] bool repeat the drawing."""
    drawn = image[unknown]
    drawn = drawn if background is None else drawn + background
    drawn = drawn if gain is None else drawn * gain
    found = target.copy()
    found[unknown] = np.rint(255 * np.clip(drawn, 0, 1)).astype(np.uint8)
    return found


@contextmanager
def _put_back(frozen: rasterize.Frozen, tiles: np.ndarray) -> Iterator[None]:
    """Restore tiles [K] of the image and of alpha after the `with` block."""
    held = np.empty((len(tiles), TILE, TILE, 4), np.float32)
    _keep.over(len(tiles), frozen.image, frozen.alpha, tiles, held, grain=GRAIN)
    try:
        yield
    finally:
        _restore.over(len(tiles), frozen.image, frozen.alpha, tiles, held, grain=GRAIN)


@range_kernel(F3, F2, L1, F4)
def _keep(first, last, image, alpha, tiles, held):
    across = (alpha.shape[1] + TILE - 1) // TILE
    for k in range(first, last):
        top, left = tiles[k] // across * TILE, tiles[k] % across * TILE
        for r in range(min(TILE, alpha.shape[0] - top)):
            for c in range(min(TILE, alpha.shape[1] - left)):
                for channel in range(3):
                    held[k, r, c, channel] = image[top + r, left + c, channel]
                held[k, r, c, 3] = alpha[top + r, left + c]


@range_kernel(F3, F2, L1, F4)
def _restore(first, last, image, alpha, tiles, held):
    across = (alpha.shape[1] + TILE - 1) // TILE
    for k in range(first, last):
        top, left = tiles[k] // across * TILE, tiles[k] % across * TILE
        for r in range(min(TILE, alpha.shape[0] - top)):
            for c in range(min(TILE, alpha.shape[1] - left)):
                for channel in range(3):
                    image[top + r, left + c, channel] = held[k, r, c, channel]
                alpha[top + r, left + c] = held[k, r, c, 3]
