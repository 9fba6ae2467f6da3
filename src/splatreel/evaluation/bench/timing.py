"""Wall times of work that is repeated, as medians."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

Timing = dict[str, float | int | str]
"""A row of a table of timings: what was measured, of which size, and its numbers."""


def median_ms(work: Callable[[], object], repeats: int) -> float:
    """Median milliseconds of `repeats` calls after one that is not counted, since it may compile."""
    return medians_ms([work], repeats)[0]


def medians_ms(works: Sequence[Callable[[], object]], repeats: int) -> list[float]:
    """The same of each, called in turns: what else the machine does falls on all."""
    times: list[list[float]] = [[] for _ in works]
    for turn in range(repeats + 1):
        for work, measured in zip(works, times, strict=True):
            start = time.perf_counter()
            work()
            if turn:
                measured.append(1000 * (time.perf_counter() - start))
    return [round(float(np.median(measured)), 3) for measured in times]


def ratio(slow: float, quick: float) -> float:
    """slow / quick, to two places."""
    return round(slow / quick, 2)
