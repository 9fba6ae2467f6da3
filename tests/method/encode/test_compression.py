"""Importance of points, and the search of a coarseness."""

from dataclasses import replace

import numpy as np
import pytest

from splatreel.base.errors import UsageError
from splatreel.kernels import splat
from splatreel.kernels.image import render_image
from splatreel.method.encode import compression
from splatreel.method.encode.compression import weigh
from splatreel.run.output.reencode import search_coarseness
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians
from tests.method.scenes import look_at


def test_importance_of_hidden_points_is_small() -> None:
    means = np.array([[0, 0, 0], [0, 0, 2.0], [90, 0, 0], [0.4, 0, 0]])
    scales = np.array([[0.3] * 3, [0.05] * 3, [0.1] * 3, [0.1] * 3])
    points = Gaussians(means, np.tile([1.0, 0, 0, 0], (4, 1)), scales, np.array([0.99] * 4), np.ones((4, 1, 3)))
    viewmat = np.eye(4)
    viewmat[2, 3] = 4
    camera = Camera("front", viewmat, np.array([[60, 0, 32], [0, 60, 24], [0, 0, 1]]), 64, 48)
    found = weigh([points, points], [camera], 0.01)
    assert found.shape == (4, 3)
    assert (found[2] == 0).all()
    assert (found[1] < 0.1 * found[0]).all()
    assert (found[3] > 0).all()
    assert found[0, 1] > found[3, 1]  # larger points matter more
    np.testing.assert_array_equal(found, weigh([points, points], [camera], 0.01))


def test_importance_sums_over_moments() -> None:
    """A point that only the last moment shows has its weight; a point that all moments show has more."""
    away, here = np.array([[0.0, 0, 0], [90, 0, 0]]), np.array([[0.0, 0, 0], [0.5, 0, 0]])
    first, last = (
        Gaussians(means, np.tile([1.0, 0, 0, 0], (2, 1)), np.full((2, 3), 0.1), np.full(2, 0.9), np.ones((2, 1, 3)))
        for means in (away, here)
    )
    viewmat = np.eye(4)
    viewmat[2, 3] = 4
    cameras = [Camera("front", viewmat, np.array([[60, 0, 32], [0, 60, 24], [0, 0, 1]]), 64, 48)]
    few, many = (weigh([*[first] * count, last], cameras, 0.01) for count in (24, 99))
    assert (few[1] > 0).all()
    np.testing.assert_allclose(many[0], 2 * few[0], rtol=0.3)  # squares add up over four times as many images


SIZES = {"scales": 0.15, "sh": 0.05, "means": 0.015}
"""Largest changes of attributes whose derivative is taken: of the logarithm of scales, of colors, and of positions."""


@pytest.mark.parametrize("antialias", [False, True])
def test_importance_is_the_derivative_of_a_weighted_image(antialias: bool) -> None:
    rng = np.random.default_rng(4)
    values = rng.uniform(-0.6, 0.6, (3, 3)), rng.normal(size=(3, 4)), rng.uniform(0.05, 0.2, (3, 3))
    points = Gaussians(*values, rng.uniform(0.3, 0.9, 3), 0.3 * rng.normal(size=(3, 4, 3)))
    camera = look_at([0.3, -0.2, -3], width=40, height=30)
    rows, columns = np.mgrid[:30, :40] / 6
    weights = np.stack([np.sin(rows + k) * np.cos(columns - k) for k in range(3)], -1).astype(np.float32)

    def value(name: str, row: int, axis: int, way: float) -> float:
        array = getattr(points, name).copy()
        target = array[:, 0] if name == "sh" else array
        target[row, axis] = target[row, axis] * np.exp(way) if name == "scales" else target[row, axis] + way
        drawn = render_image(replace(points, **{name: array}), camera, near=0.1, antialias=antialias)
        return float((drawn.astype(np.float64) * weights).sum())

    def slope(name: str, row: int, axis: int, size: float) -> float:
        """Fit many values: a splat ends where its alpha is 1/255, so that a single difference is noisy."""
        ways = np.linspace(-size, size, 25)
        return float(np.polyfit(ways, [value(name, row, axis, way) for way in ways], 3)[-2])

    expected = [
        [np.hypot.reduce([slope(name, row, axis, size) for axis in range(3)]) for name, size in SIZES.items()]
        for row in range(len(points))
    ]
    found = np.sqrt(compression._squares(points, camera, 1.0, weights, 0.1, antialias))
    np.testing.assert_allclose(found, expected, rtol=0.08 if antialias else 0.03)


def test_gradient_through_antialiasing_is_exact() -> None:
    rng = np.random.default_rng(0)
    conics = np.concatenate(
        [rng.uniform([1, -0.5, 1], [4, 0.5, 4], (20, 3)), [[10.0, 0, 10.0]]]
    )  # of the last nothing is kept
    opacities, slopes = rng.uniform(0, 1, 21), rng.normal(size=21)
    found = compression._antialias_gradient(opacities, conics, slopes)
    for axis in range(3):
        ends = [splat.antialiased(opacities, conics + way * np.eye(3)[axis]) for way in (-1e-6, 1e-6)]
        np.testing.assert_allclose(found[:20, axis], (slopes * (ends[1] - ends[0]) / 2e-6)[:20], rtol=1e-5, atol=1e-7)
    assert (found[20] == 0).all()


def test_search_coarseness_reaches_rate() -> None:
    tried: list[float] = []

    def write(coarseness: float) -> float:
        tried.append(coarseness)
        return 3 * coarseness**-0.6

    assert abs(3 * search_coarseness(write, 1.7) ** -0.6 / 1.7 - 1) <= 0.05
    assert len(tried) < 10


def test_search_coarseness_refuses_unreachable_rate() -> None:
    with pytest.raises(UsageError, match=r"9 Mbit/s cannot be reached: the nearest trial has 0\.5"):
        search_coarseness(lambda coarseness: 0.5, 9.0)
