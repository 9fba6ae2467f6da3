"""Level-of-detail prediction: whole numbers of points, predicted from points nearby of coarser levels (docs/format.md).

Points come in Morton order. Every 2^k-th of them comes first, then those half way between, and so on: a level of detail at a time.
A point is predicted from the nearest points of the coarser levels, and what is left is entropy coded; the same
neighbors tell how large that will be. All arithmetic is exact, so that every decoder finds the same numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from splatreel.codec.predictive.entropy import Stream, entropy_encode, take, zigzag
from splatreel.errors import ReelError
from splatreel.jit import EXACT

FIRST_LEVEL = 64
"""The coarsest level has between this many points and twice as many, and is predicted to be zero."""
NEIGHBORS = 4
_REACH = 8
"""Points of the coarser levels, before and after in Morton order, that neighbors are chosen from."""
_WEIGHT_BITS = 12
_WEIGHT = 1 << _WEIGHT_BITS
_LIMIT = 1 << 30
DEAD_ZONE = 0.4
"""A residual is rounded up from 1 - this on: zeros are cheap."""
MAX_CLASS = 7
_EDGES = np.array([1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 512])
CONTEXTS = len(_EDGES) + 1
"""Classes of the expected size of a residual, in eighths of a step."""
_LARGEST = 4095
"""Sizes matter up to this many eighths of a step,"""
_LARGEST_SIZE = 65535
"""and of a neighbor up to this many steps of class 0."""
_CONTEXT_OF = np.searchsorted(_EDGES, np.arange(_LARGEST + 1), side="right").astype(np.uint8)


@dataclass(frozen=True)
class Levels:
    """In which order points are decoded, and from which others each is predicted.

    order: [N], level after level. starts: where each level starts in it, and N. neighbors, weights: [N, 4] by place in `order`,
    weights in 4096ths; all 0 in the first level.
    """

    order: np.ndarray
    starts: list[int]
    neighbors: np.ndarray
    weights: np.ndarray


def levels_of(quantized: np.ndarray) -> Levels:
    """The levels of points at quantized positions [N, 3] int64 below 2^21, in Morton order; every point is in one of them."""
    count = len(quantized)
    stride = 1
    while count // (2 * stride) >= FIRST_LEVEL:
        stride *= 2
    parts, strides = [np.arange(0, count, stride)], [0]
    while stride > 1:
        parts.append(np.arange(stride // 2, count, stride))
        strides.append(stride)
        stride //= 2
    sizes = [len(part) for part in parts]
    order = np.concatenate(parts).astype(np.int32)
    neighbors, weights = _nearest(np.ascontiguousarray(quantized), order, np.repeat(strides, sizes))
    return Levels(order, [0, *np.cumsum(sizes).tolist()], neighbors, weights)


@njit(**EXACT)
def _nearest(quantized, order, strides):
    """The nearest of 16 multiples of stride around each point; ties go to the earlier. Weights fall with the distance."""
    count = len(order)
    neighbors = np.zeros((count, NEIGHBORS), np.int32)
    weights = np.zeros((count, NEIGHBORS), np.int32)
    far = np.int64(1) << 60
    squares, found, nearness = np.empty(NEIGHBORS, np.int64), np.empty(NEIGHBORS, np.int64), np.empty(NEIGHBORS)
    for place in range(count):
        point, stride = order[place], strides[place]
        if stride == 0:
            continue
        squares[:], found[:] = far, 0
        for slot in range(point // stride + 1 - _REACH, point // stride + 1 + _REACH):
            candidate = slot * stride
            if candidate < 0 or candidate >= count:
                continue
            x = quantized[candidate, 0] - quantized[point, 0]
            y = quantized[candidate, 1] - quantized[point, 1]
            z = quantized[candidate, 2] - quantized[point, 2]
            square, k = x * x + y * y + z * z, NEIGHBORS
            while k > 0 and square < squares[k - 1]:
                if k < NEIGHBORS:
                    squares[k], found[k] = squares[k - 1], found[k - 1]
                k -= 1
            if k < NEIGHBORS:
                squares[k], found[k] = square, candidate
        # Square root, sum and quotient of doubles are exactly defined; the order of the sum is part of the format.
        for k in range(NEIGHBORS):
            nearness[k] = 1 / (1 + np.sqrt(np.float64(squares[k]))) if squares[k] < far else 0.0
        total, rest = ((nearness[0] + nearness[1]) + nearness[2]) + nearness[3], _WEIGHT
        for k in range(1, NEIGHBORS):
            weights[place, k] = np.floor(nearness[k] * _WEIGHT / total)
            rest -= weights[place, k]
        weights[place, 0] = rest
        neighbors[place] = found
    return neighbors, weights


def encode_lod(
    values: np.ndarray, levels: Levels, classes: np.ndarray, ends: np.ndarray | None = None
) -> tuple[bytes, np.ndarray]:
    """Encode values [N, C], in steps, as whole numbers that are off by at most (1 - DEAD_ZONE) 2^class.

    classes: [N] int64, 0 to 7. ends: [N], how many of its columns a point has (`ends_of`), the others being 0; None: all.
    Returns the bytes and the whole numbers [N, C] int32 that `decode_lod` gives.
    """
    if not np.abs(values).max(initial=0) < _LIMIT / 2:
        raise ReelError("Values are too many steps from zero to be encoded. Use a coarser step.")
    values = np.ascontiguousarray(values, np.float64)
    residuals, contexts = np.empty(values.size, np.int64), np.empty(values.size, np.uint8)
    ends = _all(values.shape) if ends is None else ends
    found, sizes = _empty(values.shape)
    used = _predict_and_round(
        values, levels.order, levels.neighbors, levels.weights, classes, ends, residuals, contexts, found, sizes
    )
    if used < 0:
        raise ReelError("Values are too many steps from zero to be encoded. Use a coarser step.")
    return entropy_encode(zigzag(residuals[:used]), contexts[:used], CONTEXTS), found


def decode_lod(
    data: bytes, shape: tuple[int, int], levels: Levels, classes: np.ndarray, ends: np.ndarray | None = None
) -> np.ndarray:
    """The whole numbers [N, C] int32 of `encode_lod`. Raises `ReelError`."""
    stream = Stream(data, CONTEXTS)
    ends = _all(shape) if ends is None else ends
    found, sizes = _empty(shape)
    if not _predict_and_read(
        levels.order, levels.neighbors, levels.weights, classes, ends, found, sizes, *stream.parts
    ):
        raise ReelError("decodes to numbers that are too large, or ends before all of them are read.")
    stream.finish()
    return found


def ends_of(values: np.ndarray, classes: np.ndarray) -> np.ndarray:
    """[N] int64: the last of a point's columns [N, C], in steps, that is not nearer to zero than rounding goes, plus one."""
    there = np.abs(values) >= (1 - DEAD_ZONE) * 2.0 ** classes[:, None]
    return np.where(there.any(1), values.shape[1] - there[:, ::-1].argmax(1), 0)


def _all(shape: tuple[int, int]) -> np.ndarray:
    return np.full(shape[0], shape[1], np.int64)


def _empty(shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """For values and for the sizes of their residuals."""
    return np.zeros(shape, np.int32), np.zeros(shape, np.uint16)


@njit(**EXACT)
def _expect(values, sizes, near, weights, shift, columns, expected, around):
    """Fills what a point's neighbors let expect in its first columns: values, and sizes of residuals in eighths of its steps.

    A loop of its own, so that a processor takes several columns at once. Doubles hold the sums exactly.
    """
    a, b, c, d = near[0], near[1], near[2], near[3]
    p, q, r, s = np.float64(weights[0]), np.float64(weights[1]), np.float64(weights[2]), np.float64(weights[3])
    for k in range(columns):
        total = p * values[a, k] + q * values[b, k] + r * values[c, k] + s * values[d, k]
        expected[k] = np.floor((total + _WEIGHT // 2) / _WEIGHT)
    e, f, g, h = np.int32(weights[0]), np.int32(weights[1]), np.int32(weights[2]), np.int32(weights[3])
    for k in range(columns):
        size = np.int32(e * np.int32(sizes[a, k])) + np.int32(f * np.int32(sizes[b, k]))
        size += np.int32(g * np.int32(sizes[c, k])) + np.int32(h * np.int32(sizes[d, k]))
        around[k] = min(size >> (_WEIGHT_BITS - 3 + shift), _LARGEST)


@njit(**EXACT)
def _predict_and_round(values, order, neighbors, weights, classes, ends, residuals, contexts, found, sizes):
    """Fills residuals and contexts, in the order of coding, and values as decoded; how many residuals, -1 where one is too large."""
    used = 0
    expected, around = np.empty(found.shape[1]), np.empty(found.shape[1], np.int32)
    for place in range(len(order)):
        point = order[place]
        shift = classes[point]
        _expect(found, sizes, neighbors[place], weights[place], shift, ends[point], expected, around)
        recent = around[0]
        for column in range(ends[point]):
            missing = (values[point, column] - expected[column]) / (1 << shift)
            steps = np.int64(np.floor(abs(missing) + DEAD_ZONE))
            residual = -steps if missing < 0 else steps
            value = np.int64(expected[column]) + (residual << shift)
            if steps >= _LIMIT or abs(value) >= _LIMIT:
                return -1
            residuals[used], contexts[used] = residual, _CONTEXT_OF[(around[column] + recent) >> 1]
            used += 1
            recent += (min(8 * steps, _LARGEST) - recent) >> 2
            found[point, column], sizes[point, column] = value, min(steps << shift, _LARGEST_SIZE)
    return used


@njit(**EXACT)
def _predict_and_read(order, neighbors, weights, classes, ends, found, sizes, lookup, states, words, raw, cursor):
    """Fills the values; whether they are in range and the stream was long enough."""
    expected, around = np.empty(found.shape[1]), np.empty(found.shape[1], np.int32)
    for place in range(len(order)):
        point = order[place]
        shift = classes[point]
        _expect(found, sizes, neighbors[place], weights[place], shift, ends[point], expected, around)
        recent = around[0]
        for column in range(ends[point]):
            number = take(_CONTEXT_OF[(around[column] + recent) >> 1], lookup, states, words, raw, cursor)
            steps = (number + 1) >> 1
            value = np.int64(expected[column]) + ((-steps if number & 1 else steps) << shift)
            if steps >= _LIMIT or abs(value) >= _LIMIT:
                return False
            recent += (min(8 * steps, _LARGEST) - recent) >> 2
            found[point, column], sizes[point, column] = value, min(steps << shift, _LARGEST_SIZE)
        if cursor[1] > len(words):
            return False
    return True
