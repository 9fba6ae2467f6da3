"""Adam in one pass over memory: a parameter and its two moments are read and written once, and nothing else is allocated."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

from splatreel.kernels.cpu.jit import ONE, PARALLEL, F, U

CHUNK = 4096  # floats a task takes


def step(
    parameter: np.ndarray,
    mean: np.ndarray,
    square: np.ndarray,
    gradient: np.ndarray,
    first: int,
    moment: tuple[float, float, float, float, int],
) -> None:
    """Changes parameter, mean and square, [n] each, in place.

    gradient: [m], of the values from `first` on; the others have none, and go on by their momentum. moment: rate, the decays of
    mean and square, eps, and the number of this step, from 1.
    """
    rate, decay, square_decay, eps, number = moment
    correction, square_correction = 1 - decay**number, math.sqrt(1 - square_decay**number)
    constants = F(rate / correction), F(decay), F(square_decay), F(1 / square_correction), F(eps)
    _step(parameter, mean, square, gradient, first, *constants)


@njit(**PARALLEL)
def _step(parameter, mean, square, gradient, first, rate, decay, square_decay, correction, eps):
    n = parameter.shape[0]
    for task in prange((n + CHUNK - 1) // CHUNK):
        start, end = task * CHUNK, min((task + 1) * CHUNK, n)
        low, high = min(max(first, start), end), max(min(first + gradient.shape[0], end), start)
        high = max(low, high)
        for a, b in ((start, low), (high, end)):
            p, m, s = parameter[a:b], mean[a:b], square[a:b]
            for j in range(U(b - a)):
                m[j] *= decay
                s[j] *= square_decay
                p[j] -= rate * m[j] / (np.sqrt(s[j]) * correction + eps)
        if high > low:
            p, m, s, g = parameter[low:high], mean[low:high], square[low:high], gradient[low - first : high - first]
            for j in range(U(high - low)):
                m[j] += (g[j] - m[j]) * (ONE - decay)
                s[j] = s[j] * square_decay + g[j] * g[j] * (ONE - square_decay)
                p[j] -= rate * m[j] / (np.sqrt(s[j]) * correction + eps)
