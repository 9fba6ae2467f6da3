"""Spherical harmonics and their known answers."""

import numpy as np
import pytest

from splatreel.base.errors import GaussiansError
from splatreel.kernels import harmonics
from tests.kernels.cases import normal
from tests.kernels.compare import floats


def test_gradient_without_directions_is_the_same():
    given = 3, normal(50, 3), normal(50, 16, 3, seed=1), normal(50, 3, seed=2)
    _, with_directions = harmonics.backward(*given, to_directions=True)
    nothing, without = harmonics.backward(*given, to_directions=False)
    assert nothing is None
    np.testing.assert_array_equal(with_directions, without)


def test_colors_are_half_a_unit_above_the_harmonics_and_not_negative():
    means, center, base, rest = (
        normal(200, 3),
        normal(3, seed=1),
        3 * normal(200, 1, 3, seed=2),
        normal(200, 8, 3, seed=3),
    )
    colors = harmonics.colors(means, center, base, rest)
    assert 0.1 < (colors == 0).mean() < 0.5
    expected = harmonics.forward(2, means - center, np.concatenate([base, rest], 1)) + 0.5
    np.testing.assert_allclose(colors, np.maximum(expected, 0), rtol=1e-4, atol=1e-5)


def test_harmonics_are_orthonormal():
    """Over the sphere, squared basis functions integrate to 1, and products of two different ones to 0."""
    directions = normal(200_000, 3)
    one = np.zeros((len(directions), 16, 3), np.float32)
    basis = []
    for k in range(0, 16, 3):
        for channel in range(min(3, 16 - k)):
            one[:, k + channel, channel] = 1
        basis.append(harmonics.forward(3, directions, one))
        one[:] = 0
    values = np.concatenate(basis, 1)[:, :16]
    np.testing.assert_allclose(4 * np.pi * values.T @ values / len(directions), np.eye(16), atol=0.03)


def test_first_band_follows_3dgs():
    coefficients = np.zeros((3, 4, 3), np.float32)
    coefficients[0, 1] = coefficients[1, 2] = coefficients[2, 3] = 1
    directions = floats([[0, 5, 0], [0, 0, 2], [3, 0, 0]])  # y, z, x: any length
    values = harmonics.forward(1, directions, coefficients)[:, 0]
    np.testing.assert_allclose(values, np.array([-1, 1, -1]) * 0.48860251, rtol=1e-6)


@pytest.mark.parametrize(("degree", "bands"), [(2, 4), (4, 25), (-1, 1)])
def test_harmonics_reject_wrong_degree(degree, bands):
    with pytest.raises(GaussiansError, match="SH degree"):
        harmonics.forward(degree, np.ones((2, 3), np.float32), np.ones((2, bands, 3), np.float32))
