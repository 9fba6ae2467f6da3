"""Whole numbers of points, predicted from points nearby: the heart of the predictive codec (docs/format.md).

Points come in Morton order. Every 2^k-th of them comes first, then those half way between, and so on: a level of detail at a time.
A point is predicted from the nearest points of the coarser levels, and what is left is entropy coded; how large it will be is told by
the same neighbours. All arithmetic is exact, so that every decoder finds the same numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splatreel.codec.entropy import Decoder, Encoder, unzigzag, zigzag
from splatreel.errors import ReelError

FIRST_LEVEL = 64
"""The coarsest level has between this many points and twice as many, and is predicted to be zero."""
NEIGHBOURS = 4
_REACH = 8
"""Points of the coarser levels, before and after in Morton order, that neighbours are chosen from."""
_CHUNK = 1 << 16
_WEIGHT_BITS = 12
_LIMIT = 1 << 30
DEAD_ZONE = 0.4
"""A residual is rounded up from 1 - this on: zeros are cheap."""
MAX_CLASS = 7
_EDGES = np.array([1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 512])
CONTEXTS = len(_EDGES) + 1
"""Classes of the expected size of a residual, in eighths of a step."""
_LARGEST = 4095
"""Sizes matter up to this many eighths of a step."""


@dataclass(frozen=True)
class Level:
    """Points [n] that are decoded together, the neighbours [n, 4] they are predicted from and their weights in 4096ths."""

    points: np.ndarray
    neighbours: np.ndarray
    weights: np.ndarray


def levels_of(lattice: np.ndarray) -> list[Level]:
    """The levels of points at lattice positions [N, 3] int64 below 2^21, in Morton order; every point is in one of them."""
    count = len(lattice)
    stride = 1
    while count // (2 * stride) >= FIRST_LEVEL:
        stride *= 2
    first = np.arange(0, count, stride)
    none = np.zeros((len(first), NEIGHBOURS), np.int64)
    levels = [Level(first, none, none)]
    while stride > 1:
        points = np.arange(stride // 2, count, stride)
        parts = [_nearest(lattice, points[i : i + _CHUNK], stride) for i in range(0, len(points), _CHUNK)]
        neighbours, weights = (np.concatenate([part[i] for part in parts]) for i in range(2))
        levels.append(Level(points, neighbours, weights))
        stride //= 2
    return levels


def _nearest(lattice: np.ndarray, points: np.ndarray, stride: int) -> tuple[np.ndarray, np.ndarray]:
    """The nearest of 16 multiples of stride around each point; ties go to the earlier. Weights fall with the distance."""
    slots = (points // stride)[:, None] + np.arange(1 - _REACH, 1 + _REACH)
    there = (slots >= 0) & (slots * stride < len(lattice))
    candidates = np.where(there, slots * stride, 0)
    squares = ((lattice[candidates] - lattice[points][:, None]) ** 2).sum(-1)
    keys = np.where(there, squares, 1 << 50) * (2 * _REACH) + np.arange(2 * _REACH)
    keys = np.sort(np.partition(keys, NEIGHBOURS - 1, axis=1)[:, :NEIGHBOURS], 1)
    chosen = np.take_along_axis(candidates, keys % (2 * _REACH), 1)
    squares = keys // (2 * _REACH)
    # Square root, sum and quotient of doubles are exactly defined; the order of the sum is part of the format.
    nearness = np.where(squares < 1 << 50, 1 / (1 + np.sqrt(squares.astype(np.float64))), 0)
    total = ((nearness[:, 0] + nearness[:, 1]) + nearness[:, 2]) + nearness[:, 3]
    weights = np.floor(nearness * (1 << _WEIGHT_BITS) / total[:, None]).astype(np.int64)
    weights[:, 0] = (1 << _WEIGHT_BITS) - weights[:, 1:].sum(1)
    return chosen, weights


def encode_field(values: np.ndarray, levels: list[Level], classes: np.ndarray) -> tuple[bytes, np.ndarray]:
    """Encode values [N, C], in steps, as whole numbers that are off by at most (1 - DEAD_ZONE) 2^class.

    classes: [N] int64, 0 to 7. Returns the bytes and the whole numbers [N, C] int64 that `decode_field` gives.
    """
    if not np.abs(values).max(initial=0) < _LIMIT / 2:
        raise ReelError("Values are too many steps from zero to be encoded. Use a coarser step.")
    encoder = Encoder(CONTEXTS)

    def code(contexts: np.ndarray, points: np.ndarray, column: int, predicted: np.ndarray) -> np.ndarray:
        missing = (values[points, column] - predicted) / (1 << classes[points])
        residual = (np.sign(missing) * np.floor(np.abs(missing) + DEAD_ZONE)).astype(np.int64)
        encoder.write(zigzag(residual), contexts)
        return residual

    found = _run(code, values.shape, levels, classes)
    return encoder.finish(), found


def decode_field(data: bytes, shape: tuple[int, int], levels: list[Level], classes: np.ndarray) -> np.ndarray:
    """The whole numbers [N, C] int64 of `encode_field`. Raises `ReelError`."""
    decoder = Decoder(data, CONTEXTS)

    def code(contexts: np.ndarray, points: np.ndarray, column: int, predicted: np.ndarray) -> np.ndarray:
        return unzigzag(decoder.read(contexts))

    found = _run(code, shape, levels, classes)
    decoder.finish()
    return found


def _run(code, shape: tuple[int, int], levels: list[Level], classes: np.ndarray) -> np.ndarray:
    """What encoder and decoder share: predict, let `code` say the residuals, add. [N, C] int64."""
    values = np.zeros(shape[::-1], np.int64)
    sizes = np.zeros(shape[::-1], np.int64)
    for level in levels:
        points, neighbours, weights = level.points, level.neighbours, level.weights
        shift = classes[points]
        recent = None
        for column in range(shape[1]):
            predicted = ((values[column][neighbours] * weights).sum(1) + (1 << _WEIGHT_BITS - 1)) >> _WEIGHT_BITS
            around = (sizes[column][neighbours] * weights).sum(1) >> _WEIGHT_BITS - 3 + shift
            around = np.minimum(around, _LARGEST)
            recent = around if recent is None else recent
            contexts = np.searchsorted(_EDGES, (around + recent) >> 1, side="right")
            residual = code(contexts, points, column, predicted)
            size = np.abs(residual)
            recent = recent + ((np.minimum(8 * size, _LARGEST) - recent) >> 2)
            values[column][points] = predicted + (residual << shift)
            sizes[column][points] = size << shift
            if max(size.max(initial=0), np.abs(values[column][points]).max(initial=0)) >= _LIMIT:
                raise ReelError("decodes to numbers that are too large.")
    return np.ascontiguousarray(values.T)
