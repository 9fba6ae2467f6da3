"""Regularizers of motion."""

from typing import Any, cast

import pytest
import torch

from splatreel.recon.deform.trajectory import Trajectory
from splatreel.recon.train import regularizers
from splatreel.recon.train.density import rotate


def grid():
    axis = torch.linspace(-1, 1, 4)
    return torch.stack(torch.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)


def arap(means, dx, dq, unit=1.0):
    neighbor = torch.arange(1, len(means) + 1) % len(means)
    return regularizers.arap(means, dx, dq, neighbor, torch.ones(len(means)), unit)


def test_arap_of_rigid_motion_is_zero():
    means = grid()
    dq = torch.tensor([[0.8, 0.0, 0.6, 0.0]]).expand(len(means), 4)
    dx = rotate(dq, means) + torch.tensor([0.3, -0.2, 0.5]) - means
    assert arap(means, dx, dq) < 1e-4


@pytest.mark.parametrize("kind", ["stretch", "twist"])
def test_arap_of_stretching_and_twisting_is_positive(kind):
    means = grid()
    dq = torch.tensor([[1.0, 0, 0, 0]]).repeat(len(means), 1)
    dx = torch.zeros_like(means)
    if kind == "stretch":
        dx = 0.2 * means
    else:
        dq[::2] = torch.tensor([0.8, 0.6, 0, 0])
    assert arap(means, dx, dq) > 0.05


def test_arap_is_independent_of_scale():
    means, dx = grid(), 0.1 * grid().sin()
    dq = torch.tensor([[1.0, 0, 0, 0]]).repeat(len(means), 1)
    small, large = arap(means, dx, dq), arap(1000 * means, 1000 * dx, dq, 1000.0)
    torch.testing.assert_close(small, large, rtol=1e-3, atol=1e-6)


class Polynomial:
    """Deformation with offsets t^power."""

    def __init__(self, power):
        self.power = power

    def offsets(self, means, frame):
        return torch.full_like(means, float(frame) ** self.power), torch.ones(len(means), 4)


def test_temporal_penalizes_acceleration_only():
    means = grid()
    assert regularizers.temporal(cast(Any, Polynomial(1)), means, 2, 4, 0.3, 1.0) < 1e-5
    expected = 3 * abs(0.7 * 4 + 0.3 * 16 - 2.6**2)
    torch.testing.assert_close(
        regularizers.temporal(cast(Any, Polynomial(2)), means, 2, 4, 0.3, 1.0).item(), expected, rtol=1e-4, atol=0
    )


def test_regularizers_give_gradients_to_parameters():
    means = grid()
    model = Trajectory(means, 10, 1.0)
    dx, dq = model.offsets(means, 3)
    loss = arap(means, dx + 0.1 * means, dq) + regularizers.temporal(model, means, 2, 4, 0.5, 1.0)
    loss.backward()
    grads = [leaf.grad for _, _, *offsets in model.evaluations for leaf in offsets]
    assert grads
    assert all(grad is not None and torch.isfinite(grad).all() for grad in grads)


def test_neighbors_are_ranked_and_weighted_by_distance():
    means = torch.tensor([[0.0, 0, 0], [1, 0, 0], [3, 0, 0], [3, 0.1, 0]])
    found = regularizers.Neighbors.of(means, 8)
    assert found is not None
    assert found.index.shape == found.closeness.shape == (3, 4)
    assert found.index[0].tolist() == [1, 0, 3, 2]
    assert (found.closeness[0] > found.closeness[2]).all()
    assert regularizers.Neighbors.of(means[:1], 8) is None
