"""Adam for changing rows and for knots of splines."""

import numpy as np
import pytest

from splatreel.kernels import adam as kernel
from splatreel.method.deform.knot_adam import Adam, KnotAdam

RATE, EPS = 0.02, 1e-15


def ones(*shape: int) -> np.ndarray:
    return np.ones(shape, np.float32)


def test_first_step_has_the_length_of_the_rate():
    given = ones(5, 2)
    adam = Adam(given, RATE, EPS)
    kernel.adam([adam.follow(3 * ones(5, 2))])
    assert adam.steps == 1
    np.testing.assert_allclose(adam.parameter, np.full((5, 2), 1 - RATE), rtol=1e-6)
    assert (given == 1).all(), "the given array is copied"


def test_knot_adam_leaves_knots_after_end():
    adam = Adam(ones(5, 2), RATE, EPS)
    kernel.adam([adam.follow(ones(4, 2), 1, end=3)])
    np.testing.assert_allclose(adam.parameter[:, 0], [1, 1 - RATE, 1 - RATE, 1, 1], rtol=1e-6)
    assert not adam.mean[3:].any()


def test_snapshot_restores_values_moments_and_steps() -> None:
    adam = Adam(ones(5, 2), RATE, EPS)
    kernel.adam([adam.follow(ones(5, 2))])
    restore = adam.snapshot()
    state = [each.copy() for each in (adam.parameter, adam.mean, adam.square)]
    for _ in range(2):
        kernel.adam([adam.follow(2 * ones(5, 2))])
        adam.rewrite(lambda rows: rows[:3], lambda rows: rows[:3])
        restore()
        assert adam.steps == 1
        for found, expected in zip((adam.parameter, adam.mean, adam.square), state, strict=True):
            np.testing.assert_array_equal(found, expected)


def test_knot_adam_sums_overlapping_moments() -> None:
    """Several moments between two steps add up, wherever their knots overlap."""
    rng = np.random.default_rng(0)
    start = rng.standard_normal((9, 5, 3), np.float32)
    knots, whole = KnotAdam(start, RATE, EPS), Adam(start, RATE, EPS)
    for turn in ((0,), (2, 3, 5), (1, 5), (4, 4)):
        moments, total = [], np.zeros_like(start)
        for knot in turn:
            weights, gradient = np.arange(1, 5, dtype=np.float32) + knot, rng.standard_normal((5, 3), np.float32)
            moments.append((knot, weights, gradient))
            total[knot : knot + 4] += weights[:, None, None] * gradient
        taken = knots.at(moments)
        assert taken is not None
        kernel.adam([taken])
        kernel.adam([whole.follow(total)])
        np.testing.assert_allclose(knots.values, whole.parameter, rtol=1e-5, atol=1e-6)
        assert knots.steps == whole.steps


def test_knot_adam_without_moments_returns_none() -> None:
    adam = KnotAdam(ones(6, 4, 2), RATE, EPS)
    assert adam.at([]) is None
    assert adam.steps == 0


@pytest.mark.parametrize(("size", "close"), [(1e-2, 2e-6), (1e-9, 3e-5)])
def test_deferred_steps_equal_steps_one_by_one(size: float, close: float) -> None:
    """Knots that no moment changes for a while end where steps without gradient would have taken them.

    Steps for gradients near eps may differ by a thousandth.
    """
    rng, shape, eps = np.random.default_rng(0), (30, 700, 3), 1e-12
    start = rng.normal(size=shape).astype(np.float32)
    knots, whole = KnotAdam(start, RATE, eps), Adam(start, RATE, eps)
    weights, end = np.array([0.1, 0.5, 0.3, 0.1], np.float32), 8
    stepped = []
    for number in range(240):
        knots.rate = whole.rate = RATE * 0.1 ** (number / 240)
        end = min(end + (number % 5 == 0), len(start))
        turn = rng.integers(0, end - 3, 1 + (number % 7 == 0)).tolist()
        gradients = [rng.normal(0, size, shape[1:]).astype(np.float32) for _ in turn]
        total = np.zeros(shape, np.float32)
        for knot, gradient in zip(turn, gradients, strict=True):
            total[knot : knot + 4] += weights[:, None, None] * gradient
        taken = knots.at([(knot, weights, gradient) for knot, gradient in zip(turn, gradients, strict=True)], end)
        assert taken is not None
        stepped.append(taken.end - taken.begin)
        kernel.adam([taken])
        kernel.adam([whole.follow(total, 0, end)])
        knot = int(rng.integers(0, end - 3))
        some = slice(knot, knot + 4)
        np.testing.assert_allclose(knots.current(knot, knot + 4)[some], whole.parameter[some], rtol=1e-5, atol=close)
        if number == 150:
            restore = knots.snapshot()
            restore()
            knots.rewrite(lambda rows: rows[:, 50:], lambda rows: rows[:, 50:])
            whole.rewrite(lambda rows: rows[:, 50:], lambda rows: rows[:, 50:])
            shape = (30, 650, 3)
    np.testing.assert_allclose(knots.values, whole.parameter, rtol=1e-5, atol=close)
    np.testing.assert_allclose(knots.mean, whole.mean, rtol=1e-4, atol=1e-6 * size)
    assert np.mean(stepped) < 8, "most knots are left alone"


def test_restored_splines_owe_no_steps() -> None:
    """Steps that were deferred after a snapshot do not follow its restored values."""
    knots = KnotAdam(ones(30, 700, 3), RATE, 1e-12)
    weights, slope = np.ones(4, np.float32), ones(700, 3)
    kernel.adam([step for step in [knots.at([(0, weights, slope)])] if step])
    restore = knots.snapshot()
    expected = knots.values.copy()
    for _ in range(3):
        kernel.adam([step for step in [knots.at([(20, weights, slope)])] if step])
    restore()
    np.testing.assert_array_equal(knots.values, expected)


@pytest.mark.parametrize("knots", [5, 30])
def test_small_or_short_splines_are_not_deferred(knots: int) -> None:
    """Deferring costs more than it saves where nearly all knots are in use."""
    adam = KnotAdam(ones(knots, 10, 2), RATE, EPS)
    taken = adam.at([(0, np.ones(4, np.float32), ones(10, 2))])
    assert taken is not None
    assert (taken.begin, taken.end) == (0, knots)
