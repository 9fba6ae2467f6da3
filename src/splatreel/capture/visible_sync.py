"""Synchronization of videos without sound by what all cameras see at once: motion, and light that flashes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import av
import numpy as np
from av.error import FFmpegError

from splatreel.errors import CaptureError

RATE = 120
"""Samples of activity per second. A peak between samples is interpolated; times are exact to about half a frame."""
LONGEST = 180
"""Maximum seconds of a video that are used."""
WIDTH, HEIGHT = 64, 36
"""Size in pixels of the pictures that are compared."""
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
        with av.open(str(file)) as container:
            for frame in container.decode(video=0):
                if frame.time is None:
                    continue
                picture = frame.reformat(WIDTH, HEIGHT, "gray").to_ndarray().astype(np.float32)
                if before is not None:
                    change = picture - before
                    times.append(frame.time)
                    light.append(float(change.mean()))
                    motion.append(float(np.abs(change - change.mean()).mean()))
                elif not times:
                    first = frame.time
                before = picture
                if frame.time - first > LONGEST:
                    break
    except (FFmpegError, OSError) as error:
        raise CaptureError(f"{file}: cannot be decoded ({error}). Copy it again.") from error
    if len(times) < 2:
        return np.zeros((2, 0))
    places = np.arange(int((times[-1] - first) * RATE)) / RATE
    return np.stack([np.interp(places, np.array(times) - first, values) for values in (motion, light)])


def compare_activity(one: np.ndarray, other: np.ndarray) -> VisibleAgreement:
    """Return the alignment of two activities [2, samples] at which motion and light correlate best."""
    shortest = min(one.shape[1], other.shape[1])
    overlap = round(OVERLAP * RATE)
    if shortest < overlap:
        return VisibleAgreement(0.0, 0.0, 0.0)
    length = 1 << (one.shape[1] + other.shape[1]).bit_length()
    a, b = _prepare(one), _prepare(other)
    product = sum(_correlate(x, y, length) for x, y in zip(a, b, strict=True))
    power = _correlate((a**2).sum(0), np.ones(b.shape[1]), length) * _correlate(
        np.ones(a.shape[1]), (b**2).sum(0), length
    )
    common = _correlate(np.ones(a.shape[1]), np.ones(b.shape[1]), length)
    fit = np.where(common >= overlap, product / np.sqrt(np.maximum(power, 1e-12)), -1.0)
    best = int(fit.argmax())
    away = round(APART * RATE)
    rival = float(np.roll(fit, -best)[away:-away].max())
    left, middle, right = (float(fit[(best + step) % length]) for step in (-1, 0, 1))
    bend = left - 2 * middle + right
    place = best + (0.5 * (left - right) / bend if bend < 0 else 0.0)
    later = (place if best < length // 2 else place - length) / RATE
    return VisibleAgreement(later, middle, middle / max(rival, 1e-6))


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
