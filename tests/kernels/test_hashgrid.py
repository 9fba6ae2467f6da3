"""The hash grid compared with the twin and with known answers."""

import numpy as np
import pytest
import torch

from splatreel.base.errors import GaussiansError
from splatreel.kernels import motion, twin
from tests.kernels.compare import assert_parity

RESOLUTIONS = np.array([[4, 4, 3], [8, 9, 5], [33, 32, 16]])  # two dense levels and a hashed one


@pytest.mark.parametrize("features", [1, 2, 4])
def test_hashgrid_equals_twin(features):
    generator = torch.Generator().manual_seed(features)
    coords = torch.rand(400, 3, generator=generator)
    table = torch.randn(3, 1024, features, generator=generator)
    assert_parity(
        lambda c, t: motion.hashgrid(c, t, RESOLUTIONS), lambda c, t: twin.hashgrid(c, t, RESOLUTIONS), [coords, table]
    )


def test_hashgrid_equals_twin_at_and_beyond_the_ends():
    coords = torch.tensor([[0.0, 0, 0], [1, 1, 1], [1.5, 0.3, 0.2], [0.1, -2, 0.3], [0.3, 1, 0]])
    table = torch.randn(3, 1024, 2, generator=torch.Generator().manual_seed(0))
    fast, slow = motion.hashgrid(coords, table, RESOLUTIONS), twin.hashgrid(coords, table, RESOLUTIONS)
    torch.testing.assert_close(fast, slow)


def test_dense_level_reproduces_linear_function():
    """Trilinear interpolation of a linear function is exact, in value and in slope."""
    grid = torch.stack(torch.meshgrid(*[torch.arange(5.0) / 4] * 3, indexing="ij"), -1)
    slope = torch.tensor([0.3, -2.0, 1.5])
    table = torch.zeros(1, 128, 1)
    table[0, :125, 0] = (grid @ slope).permute(2, 1, 0).reshape(-1)  # x runs fastest
    coords = torch.rand(50, 3, generator=torch.Generator().manual_seed(0)).requires_grad_()
    value = motion.hashgrid(coords, table, np.array([[4, 4, 4]]))
    torch.testing.assert_close(value[:, 0], coords @ slope)
    value.sum().backward()
    assert coords.grad is not None
    torch.testing.assert_close(coords.grad, slope.expand(50, 3))


def test_hashgrid_accepts_no_points():
    assert motion.hashgrid(torch.zeros(0, 3), torch.zeros(3, 1024, 2), RESOLUTIONS).shape == (0, 6)


@pytest.mark.parametrize("size", [1000, 1024])
def test_hashgrid_rejects_wrong_shapes(size):
    resolutions = RESOLUTIONS if size == 1000 else RESOLUTIONS[:2]
    with pytest.raises(GaussiansError, match="power of two"):
        motion.hashgrid(torch.zeros(2, 3), torch.zeros(3, size, 2), resolutions)
