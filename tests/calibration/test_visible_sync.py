import numpy as np
import pytest

from splatreel.calibration.visible_sync import RATE, align_drifting, compare_activity, search_parts


def test_a_flash_synchronizes_a_silent_video() -> None:
    rng = np.random.default_rng(3)
    one, other = (rng.normal(0, 0.2, (2, 1200)) for _ in range(2))
    one[1, 600:604] += 40
    other[1, 240:244] += 25
    agreement = compare_activity(one, other)
    assert agreement.certain
    assert agreement.later == pytest.approx(3.0, abs=0.01)


def test_unrelated_activity_is_not_certain() -> None:
    rng = np.random.default_rng(4)
    assert not compare_activity(*rng.normal(0, 1, (2, 2, 1200))).certain
    assert not compare_activity(np.zeros((2, 1200)), np.zeros((2, 1200))).certain
    assert not compare_activity(np.zeros((2, 9)), np.zeros((2, 1200))).certain


def activity(began: float, rate: float, seconds: float = 60) -> np.ndarray:
    """Return motion and light of a scene with a jerk in each second, of a video with a clock of another speed."""
    rng = np.random.default_rng(5)
    jerks = np.cumsum(rng.uniform(0.3, 1.7, 90))
    times = began + np.arange(round(seconds * RATE)) / RATE / rate
    return np.exp(-(((times[None, :] - jerks[:, None]) / 0.05) ** 2)).sum(0) * np.array([[8.0], [1.0]])


@pytest.mark.parametrize(("rate", "certain"), [(1.001, True), (0.997, False)])
def test_clocks_of_other_speeds_are_found_by_motion(rate: float, certain: bool) -> None:
    one, other = activity(0.0, 1.0), activity(1.0, rate)
    whole = compare_activity(one, other)
    assert whole.certain == certain
    found = align_drifting(one, other, whole.later, 0.016) if certain else search_parts(one, other)
    assert found is not None
    lag, agreement = found
    assert lag.drift == pytest.approx(1 - rate, abs=1e-4)
    assert lag.start == pytest.approx(rate, abs=0.01)
    assert agreement.certain


def test_clocks_of_one_speed_do_not_drift() -> None:
    one, other = activity(0.0, 1.0), activity(1.0, 1.0)
    assert align_drifting(one, other, 1.0, 0.016) is None
