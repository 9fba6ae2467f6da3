"""Adam for many arrays in one pass over memory.

A value and its two moments are read and written once. No other memory is allocated.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numba import njit, types

from splatreel.base.jit import F1, F2, L1, range_kernel
from splatreel.kernels.scalars import ONE, ZERO, U

CHUNK = 4096
"""Floats in a task."""
GRAIN = 16
"""Smallest number of tasks that is worth a thread."""
SLOTS = 9
"""Arrays in a call of the kernel: the six attributes of a group's points, and three levels of splines."""


@dataclass(frozen=True)
class Trained:
    """A parameter and the moments of its gradient, mean and square. All are [R, ...] float32, contiguous and changed in place."""

    parameter: np.ndarray
    mean: np.ndarray
    square: np.ndarray

    @cached_property
    def flat(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Flat arrays [n] that share the memory of parameter, mean and square."""
        arrays = self.parameter, self.mean, self.square
        assert all(array.flags.c_contiguous for array in arrays), "a flat copy would lose the steps"
        parameter, mean, square = (array.reshape(-1) for array in arrays)
        return parameter, mean, square


class Step(NamedTuple):
    """One step of Adam for one array.

    gradient [G, ...] belongs to consecutive blocks of G rows from row `start` on, one block per factor in factors [f] float32. The
    gradient of block k is factors[k] * gradient. Other rows from `begin` to `end` have a gradient of 0. Rows before `begin` and from
    `end` on do not change.
    moment: the learning rate, the decays of mean and square, eps, and the number of this step, from 1.
    """

    trained: Trained
    gradient: np.ndarray
    factors: np.ndarray
    start: int
    end: int
    moment: tuple[float, float, float, float, int]
    begin: int = 0


class Missed(NamedTuple):
    """Steps without gradient that consecutive rows of an array have missed, from row `begin` on.

    lengths [R] float32: sum of the lengths of a row's missed steps, in units of mean / (sqrt(square) + epsilon) at its last step.
    epsilons [R] float32: mean epsilon of these steps, likewise.
    decays, square_decays: [R] float32, factors of mean and square over the missed steps.
    """

    trained: Trained
    begin: int
    lengths: np.ndarray
    epsilons: np.ndarray
    decays: np.ndarray
    square_decays: np.ndarray


_EMPTY = np.zeros(0, np.float32)


def adam(steps: Sequence[Step]) -> None:
    """Take one step of Adam for each array, in place."""
    for first in range(0, len(steps), SLOTS):
        _step_some(steps[first : first + SLOTS])


def _step_some(steps: Sequence[Step]) -> None:
    """Take up to `SLOTS` steps at once, so that small arrays are divided among threads too."""
    places, starts = np.zeros(SLOTS + 1, np.int64), np.zeros(SLOTS, np.int64)
    constants = np.zeros((SLOTS, 5), np.float32)
    slots = [(_EMPTY,) * 5] * SLOTS
    for k, step in enumerate(steps):
        size = math.prod(step.gradient.shape[1:])
        rows = slice(step.begin * size, step.end * size)
        parameter, mean, square = (array[rows] for array in step.trained.flat)
        slots[k] = parameter, mean, square, np.ascontiguousarray(step.gradient).reshape(-1), step.factors
        places[k + 1] = -(-len(parameter) // CHUNK)
        starts[k], constants[k] = (step.start - step.begin) * size, _constants(*step.moment)
    np.cumsum(places, out=places)
    _step.over(int(places[-1]), *zip(*slots, strict=True), starts, constants, places, grain=GRAIN)


def catch_up(missed: Missed) -> None:
    """Take the steps without gradient that rows have missed, in place and at once."""
    trained, begin, *columns = missed
    size, count = math.prod(trained.parameter.shape[1:]), len(missed.lengths)
    rows = slice(begin * size, (begin + count) * size)
    _catch_up.over(count, *(array[rows] for array in trained.flat), *columns)


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
    for j in range(U(first), U(last)):
        m[j] *= decay
        s[j] *= square_decay
        p[j] -= rate * m[j] / (np.sqrt(s[j]) * correction + eps)


@njit(inline="always")
def _step_chunk(p, m, s, g, factors, start, constants, first):
    """Update one chunk of one array. From `start` on, block k of the size of g has the gradient factors[k] * g."""
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
    """Update chunks of several arrays. Array k has the chunks from places[k] on."""
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
