"""Splines over a group's frames: partition of unity, lines, sharp turns."""

import numpy as np
import pytest

from splatreel.method.deform.spline import Spline


def value(spline, controls, frame):
    knot, weights = spline.at(frame)
    return np.einsum("k,knd->nd", weights, controls[knot : knot + 4])


@pytest.mark.parametrize("bends", [(), (3, 8)])
def test_spline_weights_sum_to_one_and_are_continuous(bends):
    spline = Spline(12, bends)
    for frame in (0, 0.3, 1.0, 7.999, 8.0, 11.0):
        assert abs(spline.at(frame)[1].sum() - 1) < 1e-6
    border = float(spline.breaks[2])
    left, right = spline.at(border - 1e-6), spline.at(border)
    assert right[0] == left[0] + 1
    assert abs(left[1][1:] - right[1][:3]).max() < 1e-5


@pytest.mark.parametrize("frames", [1, 2, 3, 35])
def test_spline_reproduces_lines(frames):
    spline = Spline(frames)
    line = np.arange(frames, dtype=np.float32)[:, None, None] * np.array([[0.1, -0.2, 0.0]], np.float32)
    controls = spline.fit(line)
    assert controls.shape == (spline.knots, 1, 3)
    assert controls.dtype == np.float32
    for frame in range(frames):
        np.testing.assert_allclose(value(spline, controls, frame), line[frame], atol=2e-3)


def bounce(frames, at):
    away = np.abs(np.arange(frames, dtype=np.float32) - at)
    return away[:, None, None] * np.array([[0.0, 0.0, 1.0]], np.float32)


def test_spline_follows_bounce():
    paths = bounce(31, 15)
    even, close = Spline(31), Spline.along(paths)
    errors = [np.abs(s.values(s.fit(paths)) - paths).max((1, 2)) for s in (even, close)]
    assert errors[0].max() < 1, "of a frame's way, where the ball turns"
    assert errors[1].max() < 0.5 * errors[0].max()


def test_spline_adds_knots_only_at_turns():
    spline = Spline.along(bounce(31, 15))
    assert {14, 15, 16} <= set(spline.breaks)
    assert 5 not in spline.breaks
    assert len(spline.breaks) <= len(Spline(31).breaks) + 3


@pytest.mark.parametrize("shape", [(20, 4, 3), (20, 0, 3), (1, 2, 3)])
def test_spline_of_rest_has_even_knots(shape):
    assert Spline.along(np.zeros(shape, np.float32)).knots == Spline(shape[0]).knots


def test_spline_follows_bounce_of_one_part():
    """A ball has a fiftieth of all points. The tracks are noisy, and a few other points jump."""
    rng = np.random.default_rng(0)
    paths = rng.normal(0, 0.002, (31, 1000, 3)).astype(np.float32)
    parts = np.arange(1000) // 20
    paths[:, 40:60] += 0.05 * bounce(31, 15)[:, :1]
    paths[9, 990:995] += 0.5
    parts[990:995] = 99
    assert {14, 15, 16} <= set(Spline.along(paths, parts).breaks)
    assert Spline.along(paths).knots == Spline(31).knots, "the mean of all hides it"
    assert 9 not in Spline.along(paths, parts).breaks
