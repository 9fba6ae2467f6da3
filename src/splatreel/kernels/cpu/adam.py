"""Adam in one pass over memory, of many tensors at once: a value and its two moments are read and written once, and nothing else is
allocated."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit, prange

from splatreel.kernels.cpu.jit import ONE, PARALLEL, U

CHUNK = 4096  # floats a task takes


class Flat(NamedTuple):
    """A `twin.Step`, flat. parameter, mean, square: [n]; gradient: [m]; factors: [f] float32."""

    parameter: np.ndarray
    mean: np.ndarray
    square: np.ndarray
    gradient: np.ndarray
    factors: np.ndarray
    start: int
    moment: tuple[float, float, float, float, int]


def step(flats: Sequence[Flat]) -> None:
    """Changes parameter, mean and square of all in place."""
    parameters, means, squares, gradients, factors, starts, moments = zip(*flats, strict=True)
    tasks = np.cumsum([0, *[-(-len(parameter) // CHUNK) for parameter in parameters]])
    constants = np.array([_constants(*moment) for moment in moments], np.float32)
    _step(parameters, means, squares, gradients, factors, np.array(starts), tasks, constants)


def _constants(rate: float, decay: float, square_decay: float, eps: float, number: int) -> tuple[float, ...]:
    return rate / (1 - decay**number), decay, square_decay, 1 / math.sqrt(1 - square_decay**number), eps


@njit(inline="always")
def _rest(p, m, s, constants):
    """Values without a gradient go on by their momentum."""
    rate, decay, square_decay, correction, eps = constants
    for j in range(U(p.shape[0])):
        m[j] *= decay
        s[j] *= square_decay
        p[j] -= rate * m[j] / (np.sqrt(s[j]) * correction + eps)


@njit(inline="always")
def _follow(p, m, s, g, factor, constants):
    rate, decay, square_decay, correction, eps = constants
    for j in range(U(p.shape[0])):
        slope = factor * g[j]
        m[j] += (slope - m[j]) * (ONE - decay)
        s[j] = s[j] * square_decay + slope * slope * (ONE - square_decay)
        p[j] -= rate * m[j] / (np.sqrt(s[j]) * correction + eps)


@njit(**PARALLEL)
def _step(parameters, means, squares, gradients, factors, starts, tasks, constants):
    for task in prange(tasks[-1]):
        k = 0
        while tasks[k + 1] <= task:
            k += 1
        p, m, s, g, start = parameters[k], means[k], squares[k], gradients[k], starts[k]
        c = constants[k, 0], constants[k, 1], constants[k, 2], constants[k, 3], constants[k, 4]
        first = (task - tasks[k]) * CHUNK
        end = min(first + CHUNK, p.shape[0])
        low = min(max(start, first), end)
        high = max(min(start + factors[k].shape[0] * g.shape[0], end), low)
        _rest(p[first:low], m[first:low], s[first:low], c)
        _rest(p[high:end], m[high:end], s[high:end], c)
        while low < high:
            block = (low - start) // g.shape[0]
            origin = start + block * g.shape[0]
            stop = min(origin + g.shape[0], high)
            _follow(p[low:stop], m[low:stop], s[low:stop], g[low - origin : stop - origin], factors[k][block], c)
            low = stop
