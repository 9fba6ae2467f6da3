"""Level-of-detail prediction: integers of points, predicted from nearby points of coarser levels (docs/format.md).

Points are in Morton order. The first level has every 2^k-th point, the next level the points halfway between, and so
on. A point is predicted from the nearest points of coarser levels, and its residual is entropy coded. The same
neighbors predict the size of the residual. All arithmetic is exact, so that every decoder computes the same integers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from splatreel.base.errors import ReelError
from splatreel.base.jit import EXACT
from splatreel.codec.container import Section, Sections, named, section_of
from splatreel.codec.predictive.entropy import Stream, entropy_encode, take, zigzag
from splatreel.codec.quantize import number

FIRST_LEVEL = 64
"""The coarsest level has between this many points and twice as many. Its prediction is zero."""
NEIGHBORS = 4
_REACH = 8
"""Points of coarser levels before and after in Morton order, from which neighbors are chosen."""
_WEIGHT_BITS = 12
_WEIGHT = 1 << _WEIGHT_BITS
_LIMIT = 1 << 30
DEAD_ZONE = 0.4
"""A residual is rounded up from 1 - DEAD_ZONE on, because zeros are cheap."""
MAX_CLASS = 7
_EDGES = np.array([1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 512])
_CONTEXTS = len(_EDGES) + 1
"""Number of classes of the expected size of a residual, in eighths of a step."""
_LARGEST = 4095
"""Upper bound of the size of a residual, in eighths of a step."""
_LARGEST_SIZE = 65535
"""Upper bound of a neighbor's size, in steps of class 0."""
_CONTEXT_OF = np.searchsorted(_EDGES, np.arange(_LARGEST + 1), side="right").astype(np.uint8)


@dataclass(frozen=True)
class Levels:
    """Decoding order of points, and the neighbors that predict each point.

    Attributes:
        order: Points, level after level, [N].
        starts: First position of each level in `order`, then N.
        neighbors: Predicting points of each position in `order`, [N, 4]; 0 in the first level.
        weights: Their weights in 4096ths, [N, 4]; 0 in the first level.
    """

    order: np.ndarray
    starts: list[int]
    neighbors: np.ndarray
    weights: np.ndarray


def levels_of(quantized: np.ndarray) -> Levels:
    """Return the levels of quantized positions [N, 3] int64 below 2^21 in Morton order."""
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
    """Return the nearest of 16 multiples of the stride around each point, earlier ones on ties. Weights fall with distance."""
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
        # IEEE 754 defines square root, sum and quotient exactly. The order of the sum is part of the format.
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
    """Encode values [N, C], in steps, as integers with an error of at most (1 - DEAD_ZONE) 2^class.

    Args:
        values: Values in steps, [N, C].
        levels: Levels of the points.
        classes: Class of each point, [N] int64, 0 to 7.
        ends: Number of columns that each point has, [N], see `ends_of`; the others are 0. None means all.

    Returns:
        The bytes, and the integers [N, C] int32 that `decode_lod` returns.
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
    return entropy_encode(zigzag(residuals[:used]), contexts[:used], _CONTEXTS), found


def decode_lod(
    data: bytes, shape: tuple[int, int], levels: Levels, classes: np.ndarray, ends: np.ndarray | None = None
) -> np.ndarray:
    """Decode the integers [N, C] int32 of `encode_lod`. Raise `ReelError` if the data is damaged."""
    stream = Stream(data, _CONTEXTS)
    ends = _all(shape) if ends is None else ends
    found, sizes = _empty(shape)
    if not _predict_and_read(
        levels.order, levels.neighbors, levels.weights, classes, ends, found, sizes, *stream.parts
    ):
        raise ReelError("decodes to numbers that are too large, or ends before all of them are read.")
    stream.finish()
    return found


def ends_of(values: np.ndarray, classes: np.ndarray) -> np.ndarray:
    """Return the number of leading columns [N] int64 of values [N, C], in steps, after which all round to zero."""
    there = np.abs(values) >= (1 - DEAD_ZONE) * 2.0 ** classes[:, None]
    return np.where(there.any(1), values.shape[1] - there[:, ::-1].argmax(1), 0)


def _all(shape: tuple[int, int]) -> np.ndarray:
    return np.full(shape[0], shape[1], np.int64)


def _empty(shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return arrays for values and for the sizes of their residuals."""
    return np.zeros(shape, np.int32), np.zeros(shape, np.uint16)


@njit(**EXACT)
def _expect(values, sizes, near, weights, shift, columns, expected, around):
    """Predict a point's first columns from its neighbors: values, and sizes of residuals in eighths of its steps.

    This is a separate loop so that it is vectorized over columns. Doubles hold the sums exactly.
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
    """Fill residuals and contexts in coding order, and decoded values. Return the number of residuals, or -1 if one is too large."""
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
    """Fill the values. Return whether they are in range and the stream was long enough."""
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


@dataclass(frozen=True)
class Predictor:
    """Encoder and decoder of predicted values of points.

    Attributes:
        levels: Levels of the points.
        classes: Classes of shape, color and motion, [N, 3] int64, see `precision.classes_of`.
    """

    levels: Levels
    classes: np.ndarray

    def encode(self, kind: int, values: np.ndarray, step: float) -> Section:
        """Encode values [N, C] as a section."""
        data, _ = encode_lod(values / step, self.levels, self.classes[:, kind])
        return Section(data, {"codec": "field", "step": step})

    def decode(self, kind: int, sections: Sections, name: str, columns: int) -> np.ndarray:
        """Decode values [N, C] float64. Raise `ReelError` if the section is damaged."""
        section = section_of(sections, name, "field")
        step = named(name, number, section.parameters, "step", 1e-30, 1e30)
        shape = len(self.classes), columns
        return named(name, decode_lod, section.data, shape, self.levels, self.classes[:, kind]) * step

    @classmethod
    def in_file_order(cls, count: int) -> Predictor:
        """Return the predictor for points in the paper's coding: each is predicted from its neighbors in the file, all of class 0."""
        positions = np.zeros((count, 3), np.int64)
        positions[:, 0] = np.arange(count)
        return cls(levels_of(positions), np.zeros((count, 3), np.int64))
