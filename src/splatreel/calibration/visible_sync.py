"""Synchronization of videos without sound by what all cameras see at once: motion, and light that flashes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from av.error import FFmpegError

from splatreel.base.errors import CaptureError
from splatreel.calibration.clocks import Lag, fit_lag, significant_drift
from splatreel.capture.files import LOCAL, open_media

RATE = 120
"""Samples of activity per second. A peak between samples is interpolated; times are exact to about half a frame."""
LONGEST = 180
"""Maximum seconds of a video that are used."""
WIDTH, HEIGHT = 64, 36
"""Size in pixels of the images that are compared."""
SMOOTH = 1.0
"""Seconds of the moving mean that is subtracted, since slow changes align at any time."""
OVERLAP = 2.0
"""Minimum seconds that two videos must have in common."""
ALIKE = 0.3
"""Minimum correlation of two videos' activity at the best alignment."""
CLEAR = 1.3
"""Minimum ratio between the best correlation and its best rival."""
APART = 0.5
"""Minimum distance in seconds of a rival alignment."""
SLOW_MOTION = (2, 4, 8)
"""Ratios of the filmed and the stored frame rate at which videos that fit nothing are compared."""
PART = 12.0
"""Seconds of a part whose lag is measured."""
PARTS = 12
"""Maximum number of parts."""
REACH = 0.4
"""Seconds around the lag of whole videos at which parts are searched."""
ON_LINE = 0.012
"""Maximum distance in seconds of a part's lag from a drift."""
SEARCHED = 0.4
"""Minimum share of the parts on one line, where parts were searched in a whole video."""


@dataclass(frozen=True)
class VisibleAgreement:
    """Alignment of two videos: the second started `later` seconds after the first.

    Attributes:
        later: Seconds; negative if the second started before the first.
        alike: Correlation of the activity, 1 at most.
        clear: Ratio of the correlation to its best rival.
    """

    later: float
    alike: float
    clear: float

    @property
    def certain(self) -> bool:
        """True if no other alignment is nearly as good."""
        return self.alike >= ALIKE and self.clear >= CLEAR


def watch(file: Path) -> np.ndarray:
    """Return how much a video changes, [2, samples] at `RATE`: the motion, and the change of the mean brightness.

    Raises:
        CaptureError: The video cannot be decoded.
    """
    times, motion, light, before, first = [], [], [], None, 0.0
    try:
        with open_media(LOCAL, file) as container:
            for frame in container.decode(video=0):
                if frame.time is None:
                    continue
                image = frame.reformat(WIDTH, HEIGHT, "gray").to_ndarray().astype(np.float32)
                if before is not None:
                    change = image - before
                    times.append(frame.time)
                    light.append(float(change.mean()))
                    motion.append(float(np.abs(change - change.mean()).mean()))
                elif not times:
                    first = frame.time
                before = image
                if frame.time - first > LONGEST:
                    break
    except (FFmpegError, OSError) as error:
        if len(times) >= 2:  # a truncated video tells when it starts, too
            return _sampled(times, motion, light, first)
        raise CaptureError(f"{file}: cannot be decoded ({error}). Copy it again.") from error
    return _sampled(times, motion, light, first)


def _sampled(times: list[float], motion: list[float], light: list[float], first: float) -> np.ndarray:
    if len(times) < 2:
        return np.zeros((2, 0))
    places = np.arange(int((times[-1] - first) * RATE)) / RATE
    return np.stack([np.interp(places, np.array(times) - first, values) for values in (motion, light)])


def compare_activity(one: np.ndarray, other: np.ndarray) -> VisibleAgreement:
    """Return the alignment of two activities [2, samples] at which motion and light correlate best."""
    if min(one.shape[1], other.shape[1]) < round(OVERLAP * RATE):
        return VisibleAgreement(0.0, 0.0, 0.0)
    fit = _fit(one, other)
    length = len(fit)
    best = int(fit.argmax())
    away = round(APART * RATE)
    rival = float(np.roll(fit, -best)[away:-away].max())
    place, alike = _peak(fit, best)
    later = (place if best < length // 2 else place - length) / RATE
    return VisibleAgreement(later, alike, alike / max(rival, 1e-6))


def seconds(activity: np.ndarray) -> float:
    """Return the duration of an activity [2, samples]."""
    return activity.shape[1] / RATE


def sped_up(activity: np.ndarray, factor: int) -> np.ndarray:
    """Return the activity [2, samples / factor] of a video that plays several times as fast."""
    count = activity.shape[1] // factor
    return activity[:, : count * factor].reshape(2, count, factor).mean(2) * factor


def align_drifting(
    one: np.ndarray, other: np.ndarray, later: float, least: float
) -> tuple[Lag, VisibleAgreement] | None:
    """Return the lag of two activities whose clocks run at different speeds, or None for clocks of one speed.

    Args:
        one: Activity of the first video, [2, samples].
        other: Activity of the second video, [2, samples].
        later: Lag of the whole activities, seconds.
        least: Minimum change of the lag, in seconds.
    """
    return _refine(one, other, significant_drift(*_part_lags(one, other, later), ON_LINE, PART / 2, least))


def search_parts(one: np.ndarray, other: np.ndarray) -> tuple[Lag, VisibleAgreement] | None:
    """Return the lag of two activities by where parts of the first one are in the second one, or None if few parts agree."""
    return _refine(one, other, fit_lag(*_part_lags(one, other, None), ON_LINE, PART / 2, SEARCHED))


def _refine(one: np.ndarray, other: np.ndarray, line: Lag | None) -> tuple[Lag, VisibleAgreement] | None:
    """Return the lag of two activities with a drift: the second one is resampled, and compared again. None if it is uncertain."""
    if line is None:
        return None
    count, rate = other.shape[1], 1 - line.drift
    places = np.arange(round(count / rate)) * rate
    found = compare_activity(one, np.stack([np.interp(places, np.arange(count), row) for row in other]))
    return (Lag(rate * found.later, line.drift), found) if found.certain else None


def _part_lags(one: np.ndarray, other: np.ndarray, later: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Return the times of parts of the first activity, [N] seconds, and their lags [N] seconds, near `later` if it is known."""
    first = 0.0 if later is None else max(later, 0.0)
    last = one.shape[1] / RATE if later is None else min(one.shape[1] / RATE, later + other.shape[1] / RATE)
    times, lags = [], []
    if last - first <= PART or other.shape[1] < PART * RATE:
        return np.zeros(0), np.zeros(0)
    size, reach = round(PART * RATE), round(REACH * RATE)
    for time in np.linspace(first, last - PART, min(int((last - first - PART) / PART * 2) + 2, PARTS)):
        at = round(time * RATE)
        there = 0 if later is None else max(round((time - later) * RATE), 0)
        fit = _fit(one[:, at : at + size], other if later is None else other[:, there : there + size])
        near = np.concatenate([np.arange(-reach, 0), np.arange(reach)]) if later is not None else np.arange(len(fit))
        best = int(near[fit[near].argmax()])
        best -= len(fit) if best > size else 0
        place, alike = _peak(fit, best)
        if alike >= ALIKE:
            times.append(time + PART / 2)
            lags.append((at - there + place) / RATE)
    return np.array(times), np.array(lags)


def _fit(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the correlation of two activities for each shift [length]; negative shifts are at the end."""
    overlap = round(OVERLAP * RATE)
    length = 1 << (one.shape[1] + other.shape[1]).bit_length()
    a, b = _prepare(one), _prepare(other)
    product = sum(_correlate(x, y, length) for x, y in zip(a, b, strict=True))
    power = _correlate((a**2).sum(0), np.ones(b.shape[1]), length) * _correlate(
        np.ones(a.shape[1]), (b**2).sum(0), length
    )
    common = _correlate(np.ones(a.shape[1]), np.ones(b.shape[1]), length)
    return np.where(common >= overlap, product / np.sqrt(np.maximum(power, 1e-12)), -1.0)


def _peak(fit: np.ndarray, best: int) -> tuple[float, float]:
    left, middle, right = (float(fit[(best + step) % len(fit)]) for step in (-1, 0, 1))
    bend = left - 2 * middle + right
    return best + (0.5 * (left - right) / bend if bend < 0 else 0.0), middle


def _prepare(activity: np.ndarray) -> np.ndarray:
    """Return activity without slow changes, each row with unit deviation, or zero if nothing changes."""
    width = round(SMOOTH * RATE)
    kernel = np.ones(width) / width
    level = np.stack([np.convolve(np.pad(row, width, "edge"), kernel, "same")[width:-width] for row in activity])
    rest = activity - level
    spread = rest.std(1, keepdims=True)
    return np.where(spread > 1e-3, rest / np.maximum(spread, 1e-3), 0.0)


def _correlate(a: np.ndarray, b: np.ndarray, length: int) -> np.ndarray:
    """Return the sum over samples of a[later + n] b[n] for each shift `later`; negative shifts are at the end."""
    return np.fft.irfft(np.fft.rfft(a, length) * np.conj(np.fft.rfft(b, length)), length)
