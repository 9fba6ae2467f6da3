"""The hash grid and its known answers."""

import numpy as np
import pytest

from splatreel.base.errors import GaussiansError
from splatreel.kernels import hashgrid
from tests.kernels.cases import RESOLUTIONS, normal, uniform
from tests.kernels.compare import floats


def test_dense_level_reproduces_linear_function():
    """Trilinear interpolation of a linear function is exact, in value and in slope."""
    grid = np.stack(np.meshgrid(*[np.arange(5) / 4] * 3, indexing="ij"), -1)
    slope = np.array([0.3, -2.0, 1.5])
    table = np.zeros((1, 128, 1), np.float32)
    table[0, :125, 0] = (grid @ slope).transpose(2, 1, 0).reshape(-1)  # x runs fastest
    coords, cells = uniform(50, 3), np.array([[4, 4, 4]])
    np.testing.assert_allclose(hashgrid.forward(coords, table, cells)[:, 0], coords @ slope, atol=1e-6)
    found = hashgrid.coords_gradient(coords, table, np.ones((50, 1), np.float32), cells)
    np.testing.assert_allclose(found, np.broadcast_to(slope, (50, 3)), atol=1e-5)


def test_table_gradient_is_the_transpose_of_the_features():
    """The features are linear in the table, so that d . forward(t) = table_gradient(d) . t for every d and t."""
    coords, table, slopes = uniform(100, 3), normal(3, 1024, 2), normal(100, 6, seed=1)
    features = hashgrid.forward(coords, table, RESOLUTIONS)
    gradient = hashgrid.table_gradient(coords, table, slopes, RESOLUTIONS)
    assert np.sum(slopes * features) == pytest.approx(np.sum(gradient * table), rel=1e-4)


def test_coordinates_beyond_the_ends_have_no_gradient():
    coords = floats([[1.5, 0.3, -0.1]])
    found = hashgrid.coords_gradient(coords, normal(3, 1024, 2), np.ones((1, 6), np.float32), RESOLUTIONS)
    assert (found != 0).tolist() == [[False, True, False]]


def test_hashgrid_accepts_no_points():
    table = np.zeros((3, 1024, 2), np.float32)
    assert hashgrid.forward(np.zeros((0, 3), np.float32), table, RESOLUTIONS).shape == (0, 6)


@pytest.mark.parametrize("size", [1000, 1024])
def test_hashgrid_rejects_wrong_shapes(size):
    resolutions = RESOLUTIONS if size == 1000 else RESOLUTIONS[:2]
    with pytest.raises(GaussiansError, match="power of two"):
        hashgrid.forward(np.zeros((2, 3), np.float32), np.zeros((3, size, 2), np.float32), resolutions)
