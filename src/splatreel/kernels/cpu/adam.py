"""Adam for many tensors in one pass over memory.

A value and its two moments are read and written once. No other memory is allocated.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit, types

from splatreel.base.jit import F1, F2, L1, range_kernel
from splatreel.kernels.cpu.scalars import ONE, ZERO, U

CHUNK = 4096
"""Floats in a task."""
GRAIN = 16
"""Smallest number of tasks that is worth a thread."""
SLOTS = 9
"""Tensors in a call of the kernel: the six attributes of a group's points, and three levels of splines."""


class Flat(NamedTuple):
    """A `twin.Step` with flat arrays. parameter, mean, square: [n]. gradient: [m]. factors: [f] float32."""

    parameter: np.ndarray
    mean: np.ndarray
    square: np.ndarray
    gradient: np.ndarray
    factors: np.ndarray
    start: int
    moment: tuple[float, float, float, float, int]


_EMPTY = np.zeros(0, np.float32)
_UNUSED = Flat(_EMPTY, _EMPTY, _EMPTY, _EMPTY, _EMPTY, 0, (0.0, 0.0, 0.0, 0.0, 1))


def step(flats: Sequence[Flat]) -> None:
    """Take steps of Adam: change parameter, mean and square of each in place."""
    for first in range(0, len(flats), SLOTS):
        _step_some(flats[first : first + SLOTS])


def _step_some(flats: Sequence[Flat]) -> None:
    """Take up to `SLOTS` steps at once, so that small tensors are divided among threads too."""
    places, starts = np.zeros(SLOTS + 1, np.int64), np.zeros(SLOTS, np.int64)
    constants = np.zeros((SLOTS, 5), np.float32)
    for k, flat in enumerate(flats):
        places[k + 1] = -(-len(flat.parameter) // CHUNK)
        starts[k], constants[k] = flat.start, _constants(*flat.moment)
    np.cumsum(places, out=places)
    slots = [*flats, *[_UNUSED] * (SLOTS - len(flats))]
    arrays = zip(*(flat[:5] for flat in slots), strict=True)
    _step.over(int(places[-1]), *arrays, starts, constants, places, grain=GRAIN)


def catch_up(arrays: Sequence[np.ndarray], columns: Sequence[np.ndarray]) -> None:
    """Take the steps that rows have missed: change parameter, mean and square [n] in place. columns: as in `twin.Missed`."""
    _catch_up.over(len(columns[0]), *arrays, *columns)


def _constants(rate: float, decay: float, square_decay: float, eps: float, number: int) -> tuple[float, ...]:
    return rate / (1 - decay**number), decay, square_decay, 1 / math.sqrt(1 - square_decay**number), eps


def add_signs(values: np.ndarray, prices: np.ndarray, slopes: np.ndarray) -> None:
    """Add the gradient of an L1 norm: prices [D] times the signs of values [R, D], to slopes [R, D]."""
    _add_signs.over(len(values), values, prices, slopes, grain=GRAIN * CHUNK // 8)


@range_kernel(F2, F1, F2)
def _add_signs(first, last, values, prices, slopes):
    for i in range(first, last):
        for d in range(U(prices.shape[0])):
            value, price = values[i, d], prices[d]
            slopes[i, d] += (price if value > ZERO else ZERO) - (price if value < ZERO else ZERO)


@njit(inline="always")
def _rest(p, m, s, first, last, rate, decay, square_decay, correction, eps):
    """Update values first..last, whose gradient is 0."""
    for j in range(U(first), U(last)):
        m[j] *= decay
        s[j] *= square_decay
        p[j] -= rate * m[j] / (np.sqrt(s[j]) * correction + eps)


@njit(inline="always")
def _step_chunk(p, m, s, g, factors, start, constants, first):
    """Update one chunk of one tensor. From `start` on, block k of the size of g has the gradient factors[k] * g."""
    rate, decay, square_decay, correction, eps = constants[0], constants[1], constants[2], constants[3], constants[4]
    end = min(first + CHUNK, p.shape[0])
    low = min(max(start, first), end)
    high = max(min(start + factors.shape[0] * g.shape[0], end), low)
    _rest(p, m, s, first, low, rate, decay, square_decay, correction, eps)
    _rest(p, m, s, high, end, rate, decay, square_decay, correction, eps)
    while low < high:
        block = (low - start) // g.shape[0]
        origin = start + block * g.shape[0]
        stop, factor = min(origin + g.shape[0], high), factors[block]
        for j in range(U(low), U(stop)):
            slope = factor * g[j - U(origin)]
            m[j] += (slope - m[j]) * (ONE - decay)
            s[j] = s[j] * square_decay + slope * slope * (ONE - square_decay)
            p[j] -= rate * m[j] / (np.sqrt(s[j]) * correction + eps)
        low = stop


SLOT_ARRAYS = types.UniTuple(F1, SLOTS)


@range_kernel(SLOT_ARRAYS, SLOT_ARRAYS, SLOT_ARRAYS, SLOT_ARRAYS, SLOT_ARRAYS, L1, F2, L1)
def _step(first_chunk, last_chunk, parameters, means, squares, gradients, factors, starts, constants, places):
    """Update chunks of several tensors. Tensor k has the chunks from places[k] on."""
    k = 0
    for chunk in range(first_chunk, last_chunk):
        while chunk >= places[k + 1]:
            k += 1
        first = (chunk - places[k]) * CHUNK
        _step_chunk(parameters[k], means[k], squares[k], gradients[k], factors[k], starts[k], constants[k], first)


@range_kernel(F1, F1, F1, F1, F1, F1, F1)
def _catch_up(first_row, last_row, p, m, s, lengths, epsilons, decays, square_decays):
    size = p.shape[0] // lengths.shape[0]
    for row in range(first_row, last_row):
        length, eps, decay, square_decay = lengths[row], epsilons[row], decays[row], square_decays[row]
        for j in range(U(row * size), U((row + 1) * size)):
            p[j] -= length * m[j] / (np.sqrt(s[j]) + eps)
            m[j] *= decay
            s[j] *= square_decay
