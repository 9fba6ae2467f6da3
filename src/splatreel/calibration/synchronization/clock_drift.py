"""Lines through measured lags between the clocks of two cameras."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

FASTEST = 0.005
"""Maximum drift of a clock, in seconds per second. Larger ones are other frame rates."""
LEAST = 4
"""Minimum number of lags on a line."""
SHARE = 0.5
"""Minimum share of the lags on a line, where all of them are near the right one."""
STRAIGHT = 0.5
"""Maximum ratio of the residual of a line to that of a constant for a line to be a drift."""


@dataclass(frozen=True)
class Lag:
    """Difference between the clocks of two videos, in seconds.

    Attributes:
        start: Time of the first video at which the second one starts, as its clock would show it at time 0.
        drift: Change of the difference in a second of the first video.
        residual: Root mean square distance of the measured lags from this line.
        count: Number of measured lags on this line.
    """

    start: float
    drift: float = 0.0
    residual: float = 0.0
    count: int = 0

    def at(self, time: float) -> float:
        """Return the difference at a time of the first video."""
        return self.start + self.drift * time

    def reversed(self) -> Lag:
        """Return the difference of the first video from the second."""
        rate = 1 - self.drift
        return Lag(-self.start / rate, -self.drift / rate, self.residual, self.count)


def fit_lag(
    times: np.ndarray, lags: np.ndarray, tolerance: float, spread: float = 0.0, share: float = SHARE
) -> Lag | None:
    """Return the line that most lags are on, or None if few are on any.

    Args:
        times: Times of the first video, [N] seconds.
        lags: Its time minus that of the second video, [N] seconds.
        tolerance: Maximum distance of a lag from the line, in seconds.
        spread: Maximum distance of a time from that at which its lag was measured, in seconds.
        share: Minimum share of the lags that must be on it.
    """
    best = np.zeros(len(times), bool)
    for i in range(len(times)):
        for j in range(i + 1, len(times)):
            drift = (lags[j] - lags[i]) / (times[j] - times[i])
            if abs(drift) <= FASTEST:
                near = np.abs(lags - lags[i] - drift * (times - times[i])) <= tolerance + spread * abs(drift)
                if near.sum() > best.sum():
                    best = near
    if best.sum() < max(LEAST, share * len(times)):
        return None
    drift, start = np.polyfit(times[best], lags[best], 1)
    residual = float(np.sqrt(np.mean((lags[best] - start - drift * times[best]) ** 2)))
    return Lag(float(start), float(drift), residual, int(best.sum()))


def significant_drift(times: np.ndarray, lags: np.ndarray, tolerance: float, spread: float, least: float) -> Lag | None:
    """Return the line through lags if it is a drift, or None for clocks of one speed.

    Arguments are those of `fit_lag`. All lags should be near the right one, and their change must be `least` seconds.
    """
    line = fit_lag(times, lags, tolerance, spread)
    if line is None or abs(line.drift) * float(np.ptp(times)) < least:
        return None
    on = np.abs(lags - line.start - line.drift * times) <= tolerance + spread * abs(line.drift)
    return line if line.residual <= STRAIGHT * float(np.std(lags[on])) else None
