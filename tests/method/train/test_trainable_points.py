"""Trainable points and their optimizer."""

import numpy as np

from splatreel.kernels import adam
from splatreel.method.train.trainable_points import (
    NAMES,
    TrainablePoints,
    default_rates,
    sigmoid,
    to_gaussians,
    to_params,
)
from tests.method.scenes import random_gaussians


def make(count=5):
    return TrainablePoints.from_gaussians(random_gaussians(count), default_rates(1.0))


def take_a_step(points):
    """Follow the gradient of the sum of all squares."""
    adam.adam(points.follow([2 * value for value in points.params.values()]))


def test_to_params_round_trip():
    gaussians = random_gaussians(20)
    back = to_gaussians(to_params(gaussians))
    for name in ("means", "quats", "scales", "opacities", "sh"):
        np.testing.assert_allclose(getattr(back, name), getattr(gaussians, name), rtol=1e-4, atol=1e-5)


def test_parameters_are_copies_in_float32():
    gaussians = random_gaussians(20)
    points = TrainablePoints.from_gaussians(gaussians, default_rates(1.0))
    found = points.gaussians()
    take_a_step(points)
    assert (points.means != gaussians.means).any()
    np.testing.assert_array_equal(found.means, gaussians.means)
    for value in points.params.values():
        assert value.dtype == np.float32
        assert value.flags.c_contiguous


def test_sigmoid_of_any_logit_is_finite():
    with np.errstate(over="raise"):
        np.testing.assert_allclose(sigmoid(np.array([-200, 0, 200], np.float32)), [0, 0.5, 1], atol=1e-30)


def test_follow_takes_gradients_in_the_order_of_the_names():
    points = make()
    before = {name: value.copy() for name, value in points.params.items()}
    adam.adam(points.follow([np.full_like(before[name], 1.0 if name == "quats" else 0.0) for name in NAMES]))
    for name, value in points.params.items():
        expected = before[name] - (default_rates(1.0)["quats"] if name == "quats" else 0)
        np.testing.assert_allclose(value, expected, rtol=1e-5, atol=1e-6)


def test_keep_preserves_optimizer_state():
    points = make()
    take_a_step(points)
    before = points.adams["means"].mean.copy()
    points.keep(np.array([3, 1]))
    assert len(points) == 2
    np.testing.assert_array_equal(points.adams["means"].mean, before[[3, 1]])


def test_append_starts_without_momentum():
    points = make()
    take_a_step(points)
    points.append(points.rows(np.array([0, 2])))
    state = points.adams["means"].mean
    assert len(points) == 7
    assert (state[5:] == 0).all()
    assert (state[:5] != 0).any()
    before = {name: points.params[name].copy() for name in NAMES}
    take_a_step(points)
    assert all((points.params[name][5:] != before[name][5:]).any() for name in NAMES)


def test_origins_follow_the_rows_until_a_state_is_restored():
    points = make()
    restore = points.snapshot()
    points.origins = np.arange(5, dtype=np.int32)
    points.keep(np.array([4, 0, 1]))
    points.append(points.rows(np.array([0, 1])))
    assert points.origins.tolist() == [4, 0, 1, -1, -1]
    restore()
    assert len(points) == 5
    assert points.origins is None


def test_rows_are_copies():
    points = make()
    rows = points.rows(np.arange(5))
    take_a_step(points)
    assert (rows["means"] != points.means).any()


def test_scale_rates_multiplies_base_rates():
    points = make()
    points.scale_rates({"means": 0.5}, default=0.1)
    points.scale_rates({"means": 0.5}, default=0.1)
    rates = {name: adam.rate for name, adam in points.adams.items()}
    assert rates["means"] == 0.5 * default_rates(1.0)["means"]
    assert rates["quats"] == 0.1 * default_rates(1.0)["quats"]
