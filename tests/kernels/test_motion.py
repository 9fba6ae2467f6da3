"""Splines and the as-rigid-as-possible loss compared with the twin."""

import numpy as np
import pytest
import torch

from splatreel.kernels import motion, twin
from tests.kernels.compare import assert_close, assert_parity


def normal(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


WEIGHTS = np.array([0.1, 0.5, 0.3, 0.1], np.float32)


def moving(nodes: int, points: int):
    """Return the control values of nodes and points, and their skin."""
    generator, size = torch.Generator().manual_seed(1), (points, min(4, nodes))
    skin = torch.randint(max(nodes, 1), size, generator=generator), torch.rand(size, generator=generator)
    return [normal(7, nodes, 7, seed=nodes), normal(7, points, 7, seed=points)], skin


@pytest.mark.parametrize("knot", [0, 3])
@pytest.mark.parametrize(("nodes", "points"), [(0, 90), (5, 90), (64, 700), (1, 1), (2, 0)])
def test_offsets_and_gradient_equal_twin(nodes, points, knot):
    """The gradient to the controls equals the twin's autograd gradient: the gradient to the values times the four knots' weights."""
    controls, skin = moving(nodes, points)
    found = motion.offsets((controls[0], controls[1]), knot, WEIGHTS, skin, 2.5)
    doubles = [level.double().requires_grad_() for level in controls]
    wanted = twin.offsets((doubles[0], doubles[1]), knot, WEIGHTS, (skin[0], skin[1].double()), 2.5)
    slopes = normal(points, 3, seed=8), normal(points, 4, seed=9)
    torch.autograd.backward(wanted, [slope.double() for slope in slopes])
    for index, (a, b) in enumerate(zip(found, wanted, strict=True)):
        assert_close(a, b, 1e-6, f"offset {index}")
    for module in (motion, twin):
        for gradient, level in zip(module.offsets_gradient(*slopes, skin, nodes, 2.5), doubles, strict=True):
            assert level.grad is not None
            for k, weight in enumerate(WEIGHTS.tolist()):
                assert_close(weight * gradient, level.grad[knot + k], 1e-5, f"gradient to knot {k}")


def test_spline_equals_twin():
    controls = normal(9, 40, 4)
    for knot in (0, 5):
        assert_close(
            motion.spline(controls, knot, WEIGHTS), twin.spline(controls.double(), knot, WEIGHTS), 1e-6, "value"
        )


@pytest.mark.parametrize("unit", [1.0, 5.0])
def test_arap_equals_twin(unit):
    means, neighbor = normal(300, 3), torch.randint(300, (300,), generator=torch.Generator().manual_seed(2))
    neighbor[:3] = torch.arange(3)  # neighbors at distance zero
    weights = torch.rand(300, generator=torch.Generator().manual_seed(3))

    def of(module, dx, dq):
        return module.arap(means.to(dx.dtype), dx, dq, neighbor, weights.to(dx.dtype), unit)

    offsets = [0.3 * normal(300, 3, seed=4), torch.tensor([1.0, 0, 0, 0]) + 0.3 * normal(300, 4, seed=5)]
    assert_parity(lambda *o: of(motion, *o), lambda *o: of(twin, *o), offsets, 3e-5)
