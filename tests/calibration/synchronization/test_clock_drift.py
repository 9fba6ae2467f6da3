import numpy as np
import pytest

from splatreel.calibration.synchronization.clock_drift import Lag, fit_lag, significant_drift

TIMES = np.arange(20) * 4.0


def test_a_line_is_found_among_wrong_lags() -> None:
    rng = np.random.default_rng(0)
    lags = 3.2 + 0.001 * TIMES + rng.normal(0, 3e-4, 20)
    lags[rng.permutation(20)[:12]] = rng.uniform(-60, 60, 12)
    found = fit_lag(TIMES, lags, 0.003, share=0.25)
    assert found is not None
    assert found.start == pytest.approx(3.2, abs=1e-3)
    assert found.drift == pytest.approx(0.001, abs=3e-5)


def test_unrelated_lags_have_no_line() -> None:
    assert fit_lag(TIMES, np.random.default_rng(1).uniform(-60, 60, 20), 0.003, share=0.25) is None
    assert fit_lag(TIMES[:3], np.zeros(3), 0.003) is None


def test_noise_and_small_changes_are_no_drift() -> None:
    rng = np.random.default_rng(2)
    assert significant_drift(TIMES, 3.2 + rng.normal(0, 3e-4, 20), 0.003, 0.0, 0.016) is None
    assert significant_drift(TIMES, 3.2 + 1e-4 * TIMES, 0.003, 0.0, 0.016) is None
    assert significant_drift(TIMES, 3.2 + 1e-3 * TIMES, 0.003, 0.0, 0.016) is not None


def test_reversed_lags_are_those_of_the_other_clock() -> None:
    lag = Lag(2.0, 0.001)
    one = 50.0
    other = one - lag.at(one)
    assert other - one == pytest.approx(lag.reversed().at(other))
