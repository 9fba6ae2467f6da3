"""Median wall times of repeated calls."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from splatreel.base import threads

Timing = dict[str, float | int | str]
"""Row of a table of timings: what was measured, its size, and the results."""


def median_ms(work: Callable[[], object], repeats: int) -> float:
    """Return the median milliseconds of `repeats` calls after a warm-up call, which may compile."""
    return medians_ms([work], repeats)[0]


def medians_ms(works: Sequence[Callable[[], object]], repeats: int) -> list[float]:
    """Return the median milliseconds of each function. Calls alternate, so that other load on the machine affects all alike."""
    times: list[list[float]] = [[] for _ in works]
    for turn in range(repeats + 1):
        for work, measured in zip(works, times, strict=True):
            start = time.perf_counter()
            work()
            if turn:
                measured.append(1000 * (time.perf_counter() - start))
    return [round(float(np.median(measured)), 3) for measured in times]


def ratio(slow: float, quick: float) -> float:
    """Return slow / quick, rounded to two places."""
    return round(slow / quick, 2)


def on_one_thread(work: Callable[[], object]) -> None:
    """Run a function on one thread."""
    with threads.limited(1):
        work()
