"""Importance of points, and the search of a coarseness."""

import numpy as np
import pytest
import torch

from splatreel.base.errors import UsageError
from splatreel.method.encode.importance import weigh
from splatreel.run.output.reencode import search_coarseness
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians


def test_importance_of_hidden_points_is_small() -> None:
    means = np.array([[0, 0, 0], [0, 0, 2.0], [90, 0, 0], [0.4, 0, 0]])
    scales = np.array([[0.3] * 3, [0.05] * 3, [0.1] * 3, [0.1] * 3])
    points = Gaussians(means, np.tile([1.0, 0, 0, 0], (4, 1)), scales, np.array([0.99] * 4), np.ones((4, 1, 3)))
    viewmat = np.eye(4)
    viewmat[2, 3] = 4
    camera = Camera("front", viewmat, np.array([[60, 0, 32], [0, 60, 24], [0, 0, 1]]), 64, 48)
    found = weigh([points, points], [camera], 0.01, torch.device("cpu"))
    assert found.shape == (4, 3)
    assert (found[2] == 0).all()
    assert (found[1] < 0.1 * found[0]).all()
    assert (found[3] > 0).all()
    assert found[0, 1] > found[3, 1]  # larger points matter more
    np.testing.assert_array_equal(found, weigh([points, points], [camera], 0.01, torch.device("cpu")))


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
    few, many = (weigh([*[first] * count, last], cameras, 0.01, torch.device("cpu")) for count in (24, 99))
    assert (few[1] > 0).all()
    np.testing.assert_allclose(many[0], 2 * few[0], rtol=0.3)  # squares add up over four times as many images


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
