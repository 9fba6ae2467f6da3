import numpy as np
import pytest

from splatreel.calibration.sound_sync import (
    RATE,
    align_drifting,
    common_length,
    compare,
    phases,
    search_parts,
)


def heard(began: float, rate: float, seconds: float = 30) -> np.ndarray:
    """Return claps in a sound, by a clock of another speed, [samples]."""
    rng = np.random.default_rng(0)
    claps = np.cumsum(rng.uniform(0.2, 0.8, 200))
    times = began + np.arange(round(seconds * RATE)) / RATE / rate
    sound = rng.normal(0, 0.005, len(times))
    noise = np.random.default_rng(1).normal(size=(200, 400))
    for clap, own in zip(claps, noise, strict=True):
        near = (times >= clap) & (times < clap + 0.04)
        places = (times[near] - clap) * RATE
        sound[near] += np.interp(places, np.arange(400), own) * np.exp(-places / 60)
    return sound.astype(np.float32)


@pytest.mark.parametrize(("rate", "by_parts"), [(1.001, False), (0.996, True)])
def test_drifting_sounds_are_aligned_exactly(rate: float, by_parts: bool) -> None:
    a, b = heard(0.0, 1.0), heard(3.0, rate)
    length = common_length({"a": a, "b": b})
    whole = compare(phases(a, length), phases(b, length), length)
    found = search_parts(a, b) if by_parts else align_drifting(a, b, whole.later, 0.016)
    assert found is not None
    lag, agreement = found
    assert lag.drift == pytest.approx(1 - rate, abs=1e-5)
    assert lag.start == pytest.approx(3 * rate, abs=1e-3)
    assert agreement.clear > 3


def test_sounds_of_one_clock_do_not_drift() -> None:
    assert align_drifting(heard(0.0, 1.0), heard(3.0, 1.0), 3.0, 0.016) is None


def test_unrelated_sounds_have_no_common_parts() -> None:
    rng = np.random.default_rng(2)
    assert search_parts(*rng.normal(size=(2, 20 * RATE)).astype(np.float32)) is None
