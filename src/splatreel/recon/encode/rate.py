"""The coarseness at which a reel has a wanted rate, found by trying."""

from __future__ import annotations

from collections.abc import Callable

from splatreel.errors import UsageError

TRIALS = 12
"""Encodings that are tried."""


def meet_rate(write: Callable[[float], float], mbps: float) -> float:
    """Call `write` with other coarsenesses until the rate it returns is within 5 % of mbps; returns the last coarseness.

    Raises `UsageError` where no coarseness has that rate.
    """
    low, high, rate = -6.0, 8.0, 0.0
    for _ in range(TRIALS):
        octave = (low + high) / 2
        rate = write(2.0**octave)
        if abs(rate / mbps - 1) <= 0.05:
            return 2.0**octave
        low, high = (octave, high) if rate > mbps else (low, octave)
    raise UsageError(
        f"{mbps:g} Mbit/s cannot be met: the nearest tried has {rate:.3g}. Ask for another rate, or train other points."
    )
