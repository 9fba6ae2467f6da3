"""Sorting of splats into 16 x 16 tiles, front to back.

A splat ends at the ellipse where its alpha falls to 1/255. The ellipse is cut into strips, two per column of tiles. The rows of pixels
that it covers within a strip determine the tiles that the splat touches, and the rows to draw in each half of a tile. These rows hold
half as many pixels as the bounding box of the ellipse.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit

from splatreel.base.jit import B1, F1, F2, I1, I2, INT, U2, kernel, range_kernel
from splatreel.kernels.scalars import HALF, ONE, TWO, ZERO, F

TILE = 16
STRIP = TILE // 2
"""Width of a strip, pixels: the floats in a register of AVX2."""
NO_ROWS = 16 * (TILE - 1)
"""Value of `Bins.rows` for no rows: the first is after the last, and a union with other rows changes nothing."""
GRAIN = 4096
"""Smallest number of splats that is worth a thread."""
MIN_ALPHA = F(1 / 255)
LOG2_E = F(math.log2(math.e))
LOG2_255 = F(math.log2(255))
ROOM = F(2e-3)
"""Pixels added to every extent, for rounding."""
LOG_OPACITY, DEPTH = 5, 6
"""Columns of `Bins.splats`."""


@dataclass(frozen=True)
class Bins:
    """Splats prepared for rasterization and sorted into tiles, as M (splat, tile) pairs.

    splats: [N, 8] float32, half a cache line per splat: x, y, conic, log2 of the opacity, depth, and padding. The conic is scaled by
    log2 e, its diagonal also by 1/2, so that alpha = 2^(log2 opacity - (a x^2 + b x y + c y^2)).
    offsets: [tiles + 1] int32. The pairs of tile t are offsets[t] : offsets[t + 1], front to back.
    ids: [M] int32, the splat of each pair. slots: [M] int32, the slot for the gradient of each pair.
    rows: [M, 2] uint8, the first and last row that the splat covers in the left and in the right half of the tile, 16 first + last.
    first: [N + 1] int32. The slots of splat i are first[i] : first[i + 1], so that its gradient is one contiguous sum.
    """

    width: int
    height: int
    splats: np.ndarray
    offsets: np.ndarray
    ids: np.ndarray
    slots: np.ndarray
    rows: np.ndarray
    first: np.ndarray

    @cached_property
    def counts(self) -> np.ndarray:
        """Number of splats that touch each tile, [tiles]."""
        return np.diff(self.offsets)


def bin_splats(
    means2d: np.ndarray,
    conics: np.ndarray,
    opacities: np.ndarray,
    depths: np.ndarray,
    radii: np.ndarray,
    width: int,
    height: int,
) -> Bins:
    """Sort splats into tiles. Splats with radius 0, or with alpha below 1/255 everywhere, are in no tile.

    Splats of equal depth keep the order of the input.
    """
    n = len(means2d)
    tiles_x, tiles_y = -(-width // TILE), -(-height // TILE)
    splats, boxes = np.empty((n, 8), np.float32), np.empty((n, 4), np.int32)
    first, offsets = np.zeros(n + 1, np.int32), np.zeros(tiles_x * tiles_y + 1, np.int32)
    inputs = means2d, conics, opacities, depths, radii
    _prepare.over(n, *inputs, width, height, splats, boxes, first[1:], grain=GRAIN)
    np.cumsum(first, out=first)
    tiles, reaches = np.empty(first[-1], np.int32), np.empty((first[-1], 2), np.uint8)
    _cut.over(n, splats, boxes, first, width, tiles, reaches, grain=GRAIN)
    order = _depth_order(depths, first)
    ids, slots, rows = np.empty(first[-1], np.int32), np.empty(first[-1], np.int32), np.empty_like(reaches)
    _fill(order, first, tiles, reaches, offsets, ids, slots, rows)
    return Bins(width, height, splats, offsets, ids, slots, rows, first)


def tiles_of(bins: Bins, chosen: np.ndarray) -> np.ndarray:
    """Return [tiles] bool: the tiles that any of the chosen splats, [N] bool, touches."""
    found = np.zeros(len(bins.offsets) - 1, np.bool_)
    _mark.over(len(found), bins.offsets, bins.ids, chosen, found)
    return found


@range_kernel(I1, I1, B1, B1)
def _mark(first_tile, last_tile, offsets, ids, chosen, found):
    for tile in range(first_tile, last_tile):
        for pair in range(offsets[tile], offsets[tile + 1]):
            if chosen[ids[pair]]:
                found[tile] = True
                break


@njit(inline="always")
def _floor(value, least, most):
    """Return floor(value) clamped to least..most, integers >= -1. math.floor would be a slow call."""
    return int(min(max(value, F(least)), F(most)) + ONE) - 1


@njit(inline="always")
def _reach(splat):
    """Return R and the determinant 4 a c - b^2 of the ellipse a x^2 + b x y + c y^2 = R, on which alpha is 1/255."""
    # In double precision, because the difference cancels for thin splats.
    a, b, c = float(splat[2]), float(splat[3]), float(splat[4])
    return splat[5] + LOG2_255, F(4.0 * a * c - b * b)


@range_kernel(F2, F2, F1, F1, I1, INT, INT, F2, I2, I1)
def _prepare(begin, end, means2d, conics, opacities, depths, radii, width, height, splats, boxes, counts):
    """Fill splats, boxes and the number of tiles of each splat.

    A box is the first and last column, and the first and last row, of pixels; last < first if there are none.
    """
    for i in range(begin, end):
        x, y, opacity = means2d[i, 0], means2d[i, 1], opacities[i]
        a, b, c = HALF * LOG2_E * conics[i, 0], LOG2_E * conics[i, 1], HALF * LOG2_E * conics[i, 2]
        splats[i, 0], splats[i, 1], splats[i, 2], splats[i, 3], splats[i, 4] = x, y, a, b, c
        splats[i, 5], splats[i, 6], splats[i, 7] = F(math.log2(max(opacity, MIN_ALPHA))), depths[i], ZERO
        reach, determinant = _reach(splats[i])
        boxes[i, 0] = boxes[i, 2] = counts[i] = 0
        boxes[i, 1] = boxes[i, 3] = -1
        if radii[i] <= 0 or opacity < MIN_ALPHA or determinant <= ZERO:
            continue
        scale = F(4) * reach / determinant
        rx, ry = math.sqrt(scale * c) + ROOM, math.sqrt(scale * a) + ROOM
        left, right = _floor(x - rx - HALF, -1, width) + 1, _floor(x + rx - HALF, -1, width - 1)
        top, bottom = _floor(y - ry - HALF, -1, height) + 1, _floor(y + ry - HALF, -1, height - 1)
        if left <= right and top <= bottom:
            boxes[i, 0], boxes[i, 1], boxes[i, 2], boxes[i, 3] = left, right, top, bottom
            for column in range(left // TILE, right // TILE + 1):
                high, low = _strip(splats[i], boxes[i], column * TILE, TILE, width)
                counts[i] += low // TILE - high // TILE + 1 if low >= high else 0


@njit(inline="always")
def _strip(splat, box, start, width, across):
    """Return the first and last row of pixels of the ellipse within a strip of columns; last < first if there are none.

    box: see `_prepare`. start, width: first column and number of columns. The box must touch them. across: width of the image.
    """
    if max(start, 1) <= box[0] and box[1] < min(start + width, across - 1):  # the whole ellipse is in the strip
        return box[2], box[3]
    y, a, b, c = splat[1], splat[2], splat[3], splat[4]
    reach, determinant = _reach(splat)
    left = F(start) + HALF - ROOM - splat[0]
    right = left + F(width - 1) + TWO * ROOM
    extent = math.sqrt(F(4) * a * reach / determinant)
    lean = b * extent / (TWO * a)  # the ellipse is highest at x = lean, lowest at -lean
    high = -extent if left <= lean <= right else F(1e9)
    low = extent if left <= -lean <= right else F(-1e9)
    for dx in (left, right):
        square = F(4) * c * reach - determinant * dx * dx
        if square >= ZERO:
            root = math.sqrt(square)
            high = min(high, (-b * dx - root) / (TWO * c))
            low = max(low, (root - b * dx) / (TWO * c))
    first = _floor(y + high - HALF - ROOM, box[2] - 1, box[3]) + 1
    last = _floor(y + low - HALF + ROOM, box[2] - 1, box[3])
    return first, last


@njit(inline="always")
def _halves(splat, box, start, high, low, across):
    """Return the first and last row of the ellipse within the left and the right half of a column of tiles.

    start: first column of pixels. high, low: rows in both halves together. across: width of the image.
    """
    middle = start + STRIP
    if box[1] < middle:
        return high, low, low + 1, low
    if box[0] >= middle:
        return low + 1, low, high, low
    left_high, left_low = _strip(splat, box, start, STRIP, across)
    right_high, right_low = _strip(splat, box, middle, STRIP, across)
    return left_high, left_low, right_high, right_low


@njit(inline="always")
def _packed(high, low, top):
    """Return the rows high..low of pixels as in `Bins.rows`, for a tile whose first row is `top`."""
    first, last = max(high - top, 0), min(low - top, TILE - 1)
    return first * TILE + last if first <= last else NO_ROWS


@range_kernel(F2, I2, I1, INT, I1, U2)
def _cut(begin, end, splats, boxes, first, width, tiles, rows):
    """Fill the tile of every (splat, tile) pair and the rows that the splat covers in it. Splat i has the pairs from first[i] on."""
    tiles_x = (width + TILE - 1) // TILE
    for i in range(begin, end):
        pair = first[i]
        if boxes[i, 1] < boxes[i, 0]:
            continue
        for column in range(boxes[i, 0] // TILE, boxes[i, 1] // TILE + 1):
            high, low = _strip(splats[i], boxes[i], column * TILE, TILE, width)
            halves = _halves(splats[i], boxes[i], column * TILE, high, low, width)
            for row in range(high // TILE, low // TILE + 1 if low >= high else 0):
                tiles[pair] = row * tiles_x + column
                rows[pair, 0] = _packed(halves[0], halves[1], row * TILE)
                rows[pair, 1] = _packed(halves[2], halves[3], row * TILE)
                pair += 1


@kernel(F1, I1)
def _depth_order(depths, first):
    """Return the indices of the splats that touch the image, nearest first, by a stable radix sort of 11 bits at a time.

    The bits of positive floats sort like the floats, and the near plane keeps depths positive.
    """
    n = depths.shape[0]
    keys, ids = np.empty(n, np.uint32), np.empty(n, np.int32)
    bits = depths.view(np.uint32)
    counts = np.zeros((3, 2048), np.int64)
    low = np.uint32(2047)
    m = 0
    for i in range(n):
        if first[i + 1] > first[i]:
            key = bits[i]
            keys[m], ids[m] = key, i
            m += 1
            counts[0, key & low] += 1
            counts[1, (key >> np.uint32(11)) & low] += 1
            counts[2, key >> np.uint32(22)] += 1
    other_keys, other_ids = np.empty(m, np.uint32), np.empty(m, np.int32)
    for digit in range(3):
        start = 0
        for value in range(2048):
            count = counts[digit, value]
            counts[digit, value] = start
            start += count
        shift = np.uint32(11 * digit)
        for i in range(m):
            key = keys[i]
            value = (key >> shift) & low
            position = counts[digit, value]
            counts[digit, value] = position + 1
            other_keys[position], other_ids[position] = key, ids[i]
        keys, other_keys = other_keys, keys
        ids, other_ids = other_ids, ids
    return ids[:m]


@kernel(I1, I1, I1, U2, I1, I1, I1, U2)
def _fill(order, first, tiles, reaches, offsets, ids, slots, rows):
    """Sort the pairs into tiles, front to back: fill offsets (zeros before), ids, slots and rows."""
    for pair in range(tiles.shape[0]):
        offsets[tiles[pair] + 1] += 1
    for tile in range(offsets.shape[0] - 1):
        offsets[tile + 1] += offsets[tile]
    cursors = offsets[:-1].copy()
    for rank in range(order.shape[0]):
        i = order[rank]
        for pair in range(first[i], first[i + 1]):
            position = cursors[tiles[pair]]
            cursors[tiles[pair]] = position + 1
            ids[position], slots[position] = i, pair
            rows[position, 0], rows[position, 1] = reaches[pair, 0], reaches[pair, 1]
