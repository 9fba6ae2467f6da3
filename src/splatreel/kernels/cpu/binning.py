"""Which splats touch which 16 x 16 tile, front to back."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit, prange

from splatreel.kernels.cpu.jit import HALF, PARALLEL, SERIAL, ZERO, F

TILE = 16
MIN_ALPHA = F(1 / 255)
LOG2_E = F(math.log2(math.e))
FAR = F(1e6)  # extents are clamped to this many pixels before they become integers


@dataclass(frozen=True)
class Bins:
    """Splats prepared for rasterisation and sorted into tiles; M (splat, tile) pairs in all.

    splats: [N, 6] float32: x, y, the conic in powers of two (halved where the quadratic form halves it), log2 opacity.
    spans: [N, 4] int32: first and last column, first and last row where alpha may reach 1/255; last < first if none.
    offsets: [tiles + 1] int32: the pairs of tile t are offsets[t] : offsets[t + 1], front to back.
    learning: splats from this row on are frozen, and get no gradient.
    ends: [tiles] int32: the pairs of tile t from ends[t] on are all of frozen splats, so that no gradient depends on them.
    ids: [M] int32, the splat of each pair. slots: [M] int32, where the pair's gradient goes; -1 where frozen.
    first: [N + 1] int32: the slots of splat i are first[i] : first[i + 1], so that its gradient is one contiguous sum.
    wanted: [tiles_y, tiles_x] bool: the tiles to draw; the others hold no pair.
    """

    width: int
    height: int
    splats: np.ndarray
    spans: np.ndarray
    learning: int
    offsets: np.ndarray
    ends: np.ndarray
    ids: np.ndarray
    slots: np.ndarray
    first: np.ndarray
    wanted: np.ndarray


def bin_splats(
    means2d: np.ndarray,
    conics: np.ndarray,
    opacities: np.ndarray,
    depths: np.ndarray,
    radii: np.ndarray,
    width: int,
    height: int,
    wanted: np.ndarray | None = None,
    learning: int | None = None,
) -> Bins:
    """Splats with radius 0, or nowhere at alpha 1/255, are in no tile. Equal depths keep the order of the input.

    wanted: [tiles_y, tiles_x] bool, the tiles to fill; all of them if None. learning: how many splats, the first ones, get gradients;
    all of them if None.
    """
    n = len(means2d)
    learning = n if learning is None else learning
    tiles_x, tiles_y = -(-width // TILE), -(-height // TILE)
    splats, spans = np.empty((n, 6), np.float32), np.empty((n, 4), np.int32)
    _prepare(means2d, conics, opacities, radii, width, height, splats, spans)
    order = _depth_order(depths, spans)
    if wanted is None:
        wanted = np.ones((tiles_y, tiles_x), np.bool_)
    offsets, first = np.zeros(tiles_x * tiles_y + 1, np.int32), np.empty(n + 1, np.int32)
    pairs = _count(spans, wanted, learning, offsets, first)
    ends = offsets[:-1].copy()
    ids, slots = np.empty(pairs, np.int32), np.empty(pairs, np.int32)
    _fill(spans, order, wanted, learning, offsets, first, ends, ids, slots)
    return Bins(width, height, splats, spans, learning, offsets, ends, ids, slots, first, wanted)


def tile_spans(
    means2d: np.ndarray, conics: np.ndarray, opacities: np.ndarray, radii: np.ndarray, width: int, height: int
) -> np.ndarray:
    """[N, 4] int32: first and last tile column, first and last tile row that each splat touches; last < first if none."""
    splats, spans = np.empty((len(means2d), 6), np.float32), np.empty((len(means2d), 4), np.int32)
    _prepare(means2d, conics, opacities, radii, width, height, splats, spans)
    return spans // TILE


def touched_tiles(spans: np.ndarray, width: int, height: int) -> np.ndarray:
    """[tiles_y, tiles_x] bool: the tiles that any of the spans [N, 4], in tiles, covers."""
    tiles = np.zeros((-(-height // TILE), -(-width // TILE)), np.bool_)
    _cover(spans, tiles)
    return tiles


def touching(spans: np.ndarray, tiles: np.ndarray) -> np.ndarray:
    """[M] int64: which of the spans [N, 4], in tiles, cover any of the tiles, in order."""
    touches = np.empty(len(spans), np.bool_)
    _touch(spans, tiles, touches)
    return np.flatnonzero(touches)


@njit(**SERIAL)
def _cover(spans, tiles):
    for i in range(spans.shape[0]):
        for y in range(spans[i, 2], spans[i, 3] + 1):
            for x in range(spans[i, 0], spans[i, 1] + 1):
                tiles[y, x] = True


@njit(**PARALLEL)
def _touch(spans, tiles, touches):
    for i in prange(spans.shape[0]):
        found = False
        for y in range(spans[i, 2], spans[i, 3] + 1):
            for x in range(spans[i, 0], spans[i, 1] + 1):
                found = found or tiles[y, x]
        touches[i] = found


@njit(**PARALLEL)
def _prepare(means2d, conics, opacities, radii, width, height, splats, spans):
    for i in prange(means2d.shape[0]):
        x, y, opacity = means2d[i, 0], means2d[i, 1], opacities[i]
        a, b, c = conics[i, 0], conics[i, 1], conics[i, 2]
        determinant = a * c - b * b
        spans[i, 0] = spans[i, 2] = 0
        spans[i, 1] = spans[i, 3] = -1
        if radii[i] <= 0 or opacity < MIN_ALPHA or determinant <= ZERO:
            continue
        splats[i, 0], splats[i, 1] = x, y
        splats[i, 2], splats[i, 3], splats[i, 4] = HALF * LOG2_E * a, LOG2_E * b, HALF * LOG2_E * c
        splats[i, 5] = F(math.log2(opacity))
        # opacity * exp(-sigma) = 1/255 is an ellipse; its bounding box, with a little room for rounding
        reach = F(2) * F(math.log(F(255) * opacity)) / determinant
        rx, ry = math.sqrt(reach * c) + F(2e-3), math.sqrt(reach * a) + F(2e-3)
        x0, x1 = math.ceil(max(x - rx - HALF, -FAR)), math.floor(min(x + rx - HALF, FAR))
        y0, y1 = math.ceil(max(y - ry - HALF, -FAR)), math.floor(min(y + ry - HALF, FAR))
        if x1 < ZERO or y1 < ZERO or x0 > FAR or y0 > FAR:
            continue
        left, right = max(0, int(x0)), min(width - 1, int(x1))
        top, bottom = max(0, int(y0)), min(height - 1, int(y1))
        if left <= right and top <= bottom:
            spans[i, 0], spans[i, 1], spans[i, 2], spans[i, 3] = left, right, top, bottom


@njit(**SERIAL)
def _depth_order(depths, spans):
    """Indices of the splats that touch the image, nearest first: a radix sort of the float bits, 11 at a time, stable.

    The bits of positive floats sort like the floats; the near plane keeps depths positive.
    """
    n = depths.shape[0]
    keys, ids = np.empty(n, np.uint32), np.empty(n, np.int32)
    bits = depths.view(np.uint32)
    counts = np.zeros((3, 2048), np.int64)
    low = np.uint32(2047)
    m = 0
    for i in range(n):
        if spans[i, 1] >= spans[i, 0]:
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


@njit(**SERIAL)
def _count(spans, wanted, learning, offsets, first):
    """Fills offsets (prefix sums of the pairs of each tile) and first; returns the number of pairs."""
    tiles_x = wanted.shape[1]
    pairs, slots = 0, 0
    for i in range(spans.shape[0]):
        first[i] = slots
        if spans[i, 1] < spans[i, 0]:
            continue
        for tile_y in range(spans[i, 2] // TILE, spans[i, 3] // TILE + 1):
            for tile_x in range(spans[i, 0] // TILE, spans[i, 1] // TILE + 1):
                if wanted[tile_y, tile_x]:
                    offsets[tile_y * tiles_x + tile_x + 1] += 1
                    pairs += 1
        if i < learning:
            slots = pairs
    first[spans.shape[0]] = slots
    for tile in range(offsets.shape[0] - 1):
        offsets[tile + 1] += offsets[tile]
    return pairs


@njit(**SERIAL)
def _fill(spans, order, wanted, learning, offsets, first, ends, ids, slots):
    tiles_x = wanted.shape[1]
    cursors = offsets[:-1].copy()
    for rank in range(order.shape[0]):
        i = order[rank]
        slot = first[i]
        for tile_y in range(spans[i, 2] // TILE, spans[i, 3] // TILE + 1):
            for tile_x in range(spans[i, 0] // TILE, spans[i, 1] // TILE + 1):
                if not wanted[tile_y, tile_x]:
                    continue
                tile = tile_y * tiles_x + tile_x
                position = cursors[tile]
                cursors[tile] = position + 1
                ids[position], slots[position] = i, -1
                if i < learning:
                    slots[position], ends[tile] = slot, position + 1
                    slot += 1
