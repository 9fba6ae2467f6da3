"""Splines and ARAP against the twin."""

import numpy as np
import pytest
import torch

from splatreel.kernels import splat, twin
from tests.kernels.compare import assert_parity


def normal(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("rows", [(90,), (5, 90), (5, 20, 90), (1, 1, 1), (2, 0)])
@pytest.mark.parametrize("knot", [0, 3])
def test_splines(rows, knot):
    controls = [normal(7, count, 7, seed=count) for count in rows]
    generator = torch.Generator().manual_seed(1)
    size = (rows[-1], min(4, *rows)) if rows[-1] else (0, 4)
    skins = [
        (torch.randint(nodes, size, generator=generator), torch.rand(size, generator=generator)) for nodes in rows[:-1]
    ]
    weights = np.array([0.1, 0.5, 0.3, 0.1], np.float32)
    assert_parity(
        lambda *c: splat.splines(c, knot, weights, skins), lambda *c: twin.splines(c, knot, weights, skins), controls
    )


def test_only_the_four_knots_of_a_moment_get_a_gradient():
    controls = normal(7, 3, 2).requires_grad_()
    splat.splines([controls], 2, np.full(4, 0.25, np.float32), []).sum().backward()
    assert controls.grad is not None
    assert controls.grad[:, 0, 0].tolist() == [0, 0, 0.25, 0.25, 0.25, 0.25, 0]


@pytest.mark.parametrize("unit", [1.0, 5.0])
def test_arap(unit):
    means, neighbour = normal(300, 3), torch.randint(300, (300,), generator=torch.Generator().manual_seed(2))
    neighbour[:3] = torch.arange(3)  # at no distance
    weights = torch.rand(300, generator=torch.Generator().manual_seed(3))

    def of(module, dx, dq):
        return module.arap(means.to(dx.dtype), dx, dq, neighbour, weights.to(dx.dtype), unit)

    offsets = [0.3 * normal(300, 3, seed=4), torch.tensor([1.0, 0, 0, 0]) + 0.3 * normal(300, 4, seed=5)]
    assert_parity(lambda *o: of(splat, *o), lambda *o: of(twin, *o), offsets, 3e-5)
