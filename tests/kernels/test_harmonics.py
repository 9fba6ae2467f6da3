"""Spherical harmonics compared with the twin and with known answers."""

import pytest
import torch

from splatreel.base.errors import GaussiansError
from splatreel.kernels import splat, twin
from tests.kernels.compare import assert_parity


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("bands", [(0, 0), 16])  # exactly what the degree needs, and more
def test_harmonics_equal_twin(degree, bands):
    count = bands if isinstance(bands, int) else (degree + 1) ** 2
    generator = torch.Generator().manual_seed(degree)
    inputs = [torch.randn(200, 3, generator=generator), torch.randn(200, count, 3, generator=generator)]
    fast, slow = (lambda *a, m=m: m.spherical_harmonics(degree, *a) for m in (splat, twin))
    if degree == 0:  # a constant has no gradient to directions, and the twin returns None
        inputs, directions = inputs[1:], inputs[0]
        fast, slow = (lambda c, m=m: m.spherical_harmonics(0, directions.to(c.dtype), c) for m in (splat, twin))
    assert_parity(fast, slow, inputs)


def test_harmonics_gradient_without_directions_is_the_same():
    generator = torch.Generator().manual_seed(0)
    directions, coefficients = torch.randn(50, 3, generator=generator), torch.randn(50, 16, 3, generator=generator)
    gradients = []
    for wanted in (True, False):
        leaf = coefficients.clone().requires_grad_()
        toward = directions.clone().requires_grad_(wanted)
        splat.spherical_harmonics(3, toward, leaf).square().sum().backward()
        assert (toward.grad is not None) == wanted
        gradients.append(leaf.grad)
    torch.testing.assert_close(*gradients)


@pytest.mark.parametrize("bands", [1, 4, 9, 16])
def test_view_colors_equal_twin(bands):
    generator = torch.Generator().manual_seed(bands)
    means, base = torch.randn(200, 3, generator=generator), 3 * torch.randn(200, 1, 3, generator=generator)
    center, rest = torch.tensor([0.3, -2.0, 4.0]), 0.3 * torch.randn(200, bands - 1, 3, generator=generator)
    fast, slow = (lambda *a, m=m: m.view_colors(means.to(a[0].dtype), center.to(a[0].dtype), *a) for m in (splat, twin))
    assert 0.1 < (fast(base, rest) == 0).float().mean() < 0.5
    assert_parity(fast, slow, [base, rest])


def test_harmonics_are_orthonormal():
    """Over the sphere, squared basis functions integrate to 1, and products of two different ones to 0."""
    directions = torch.randn(400_000, 3, generator=torch.Generator().manual_seed(0))
    coefficients = torch.eye(16)[:, :, None].expand(-1, -1, 3)
    basis = torch.stack(
        [
            splat.spherical_harmonics(3, directions, c[None].expand(len(directions), -1, -1).contiguous())[:, 0]
            for c in coefficients
        ]
    )
    gram = 4 * torch.pi * basis @ basis.T / len(directions)
    torch.testing.assert_close(gram, torch.eye(16), atol=0.02, rtol=0)


def test_harmonics_first_band_follows_3dgs():
    coefficients = torch.zeros(3, 4, 3)
    coefficients[0, 1] = coefficients[1, 2] = coefficients[2, 3] = 1
    directions = torch.tensor([[0.0, 5, 0], [0, 0, 2], [3, 0, 0]])  # y, z, x: any length
    values = splat.spherical_harmonics(1, directions, coefficients)[:, 0]
    torch.testing.assert_close(values, torch.tensor([-1.0, 1, -1]) * 0.48860251)


@pytest.mark.parametrize(("degree", "bands"), [(2, 4), (4, 25), (-1, 1)])
def test_harmonics_reject_wrong_degree(degree, bands):
    with pytest.raises(GaussiansError, match="SH degree"):
        splat.spherical_harmonics(degree, torch.ones(2, 3), torch.ones(2, bands, 3))
