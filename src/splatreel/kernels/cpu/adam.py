"""Adam for many tensors in one pass over memory.

A value and its two moments are read and written once. No other memory is allocated.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit

from splatreel.base.jit import F1, FLOAT, INT, range_kernel
from splatreel.kernels.cpu.scalars import ONE, F, U

CHUNK = 4096
"""Floats in a task."""
GRAIN = 32
"""Smallest number of tasks that is worth a thread."""


class Flat(NamedTuple):
    """A `twin.Step` with flat arrays. parameter, mean, square: [n]. gradient: [m]. factors: [f] float32."""

    parameter: np.ndarray
    mean: np.ndarray
    square: np.ndarray
    gradient: np.ndarray
    factors: np.ndarray
    start: int
    moment: tuple[float, float, float, float, int]


def step(flats: Sequence[Flat]) -> None:
    """Take steps of Adam: change parameter, mean and square of each in place."""
    for flat in flats:
        chunks = -(-len(flat.parameter) // CHUNK)
        constants = tuple(F(value) for value in _constants(*flat.moment))
        arrays = flat.parameter, flat.mean, flat.square, flat.gradient, flat.factors
        _step.over(chunks, *arrays, flat.start, *constants, grain=GRAIN)


def catch_up(arrays: Sequence[np.ndarray], columns: Sequence[np.ndarray]) -> None:
    """Take the steps that rows have missed: change parameter, mean and square [n] in place. columns: as in `twin.Missed`."""
    _catch_up.over(len(columns[0]), *arrays, *columns)


def _constants(rate: float, decay: float, square_decay: float, eps: float, number: int) -> tuple[float, ...]:
    return rate / (1 - decay**number), decay, square_decay, 1 / math.sqrt(1 - square_decay**number), eps


@njit(inline="always")
def _rest(p, m, s, first, last, rate, decay, square_decay, correction, eps):
    """Update values first..last, whose gradient is 0."""
    for j in range(U(first), U(last)):
        m[j] *= decay
        s[j] *= square_decay
        p[j] -= rate * m[j] / (np.sqrt(s[j]) * correction + eps)


@range_kernel(F1, F1, F1, F1, F1, INT, FLOAT, FLOAT, FLOAT, FLOAT, FLOAT)
def _step(first_chunk, last_chunk, p, m, s, g, factors, start, rate, decay, square_decay, correction, eps):
    """Update chunks of one tensor. From `start` on, block k of the size of g has the gradient factors[k] * g."""
    for chunk in range(first_chunk, last_chunk):
        first = chunk * CHUNK
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


@range_kernel(F1, F1, F1, F1, F1, F1, F1)
def _catch_up(first_row, last_row, p, m, s, lengths, epsilons, decays, square_decays):
    size = p.shape[0] // lengths.shape[0]
    for row in range(first_row, last_row):
        length, eps, decay, square_decay = lengths[row], epsilons[row], decays[row], square_decays[row]
        for j in range(U(row * size), U((row + 1) * size)):
            p[j] -= length * m[j] / (np.sqrt(s[j]) + eps)
            m[j] *= decay
            s[j] *= square_decay
