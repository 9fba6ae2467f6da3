"""Antialiasing, nearest neighbors and the check of values."""

import math

import numpy as np
import pytest

from splatreel.base.errors import GaussiansError
from splatreel.kernels import splat
from splatreel.kernels.image import render_image
from splatreel.scene import rotations
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians
from tests.kernels.cases import uniform
from tests.kernels.compare import floats


@pytest.mark.parametrize("k", [1, 5])
@pytest.mark.parametrize("asked", [True, False])
def test_nearest_neighbors_equal_brute_force(k, asked):
    points, queries = uniform(200, 3), uniform(30, 3, seed=1) if asked else None
    table = np.linalg.norm((points if queries is None else queries)[:, None].astype(float) - points, axis=2)
    if queries is None:
        np.fill_diagonal(table, np.inf)
    expected = np.argsort(table, 1)[:, :k]
    indices, distances = splat.nearest_neighbors(points, k, queries)
    assert (indices.dtype, distances.dtype) == (np.int64, np.float32)
    np.testing.assert_array_equal(indices, expected)
    np.testing.assert_allclose(distances, np.take_along_axis(table, expected, 1), rtol=1e-5)


def test_nearest_neighbors_include_coinciding_points():
    indices, distances = splat.nearest_neighbors(np.zeros((4, 3), np.float32), 2)
    assert indices.shape == (4, 2)
    assert not (indices == np.arange(4)[:, None]).any()
    assert not distances.any()


@pytest.mark.parametrize("k", [0, 4])
def test_nearest_neighbors_rejects_wrong_k(k):
    with pytest.raises(GaussiansError, match="there are 3"):
        splat.nearest_neighbors(np.zeros((4, 3), np.float32), k)


def test_finite_values_pass_the_check_though_their_sum_does_not():
    splat.check_finite(means=np.full(3, 3e38, np.float32))
    with pytest.raises(GaussiansError, match="scales holds 2 values"):
        splat.check_finite(means=np.zeros(3), scales=np.array([np.inf, 0, -np.inf]))


def test_antialiased_opacity_falls_by_blurred_area():
    long, wide, angle = 4.0, 0.05, 0.6
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    inverse = np.linalg.inv(turn @ np.diag([long + 0.1, wide + 0.1]) @ turn.T)
    conics, opacity = floats([[inverse[0, 0], inverse[0, 1], inverse[1, 1]]]), floats([0.8])
    expected = math.sqrt(long * wide / ((long + 0.1) * (wide + 0.1)))
    np.testing.assert_allclose(splat.antialiased(opacity, conics), 0.8 * expected, rtol=1e-5)
    culled = splat.antialiased(opacity, np.zeros((1, 3), np.float32))
    np.testing.assert_array_equal(culled, opacity)
    assert culled.dtype == np.float32


def test_half_size_image_matches_only_with_antialias():
    rng = np.random.default_rng(0)
    count = 400
    points = Gaussians(
        means=np.concatenate([rng.uniform(-1, 1, (count, 2)), np.zeros((count, 1))], 1),
        quats=rotations.normalize(rng.normal(size=(count, 4))),
        scales=np.full((count, 3), 0.008),
        opacities=np.full(count, 0.9),
        sh=rng.uniform(0, 1.5, (count, 1, 3)),
    )

    def drawn(size, antialias):
        K = np.array([[size, 0, size / 2], [0, size, size / 2], [0, 0, 1]], np.float32)
        viewmat = np.eye(4, dtype=np.float32)
        viewmat[2, 3] = 2
        return render_image(points, Camera("c", viewmat, K, size, size), antialias=antialias)

    def difference(antialias):
        return np.abs(drawn(128, antialias).reshape(64, 2, 64, 2, 3).mean((1, 3)) - drawn(64, antialias)).mean()

    assert difference(True) < 0.4 * difference(False)
    assert drawn(64, True).mean() < 0.7 * drawn(64, False).mean()
