"""Adam for changing rows and for knots of splines."""

import numpy as np
import torch

from splatreel.kernels import adam as kernel
from splatreel.method.deform.adam import Adam, KnotAdam

RATE, EPS = 0.02, 1e-15


def test_adam_without_gradient_changes_nothing():
    adam = Adam(torch.ones(5, 2), RATE, EPS)
    adam.step()
    assert adam.steps == 0
    adam.tensor.sum().backward()
    adam.step()
    assert adam.steps == 1
    assert adam.tensor.grad is None
    torch.testing.assert_close(adam.tensor.detach(), torch.full((5, 2), 1 - RATE))


def test_knot_adam_leaves_knots_after_end():
    adam = Adam(torch.ones(5, 2), RATE, EPS)
    kernel.adam([adam.follow(torch.ones(4, 2), 1, end=3)])
    torch.testing.assert_close(adam.tensor[:, 0].detach(), torch.tensor([1, 1 - RATE, 1 - RATE, 1, 1]))
    assert not adam.mean[3:].any()


def test_knot_adam_sums_overlapping_moments() -> None:
    """Several moments between two steps add up, wherever their knots overlap."""
    generator = torch.Generator().manual_seed(0)
    start = torch.randn(9, 5, 3, generator=generator)
    knots, whole = KnotAdam(start, RATE, EPS), Adam(start, RATE, EPS)
    for turn in ((0,), (2, 3, 5), (1, 5), (4, 4)):
        moments = []
        for knot in turn:
            weights, gradient = np.arange(1, 5, dtype=np.float32) + knot, torch.randn(5, 3, generator=generator)
            moments.append((knot, weights, gradient))
            (whole.tensor[knot : knot + 4] * torch.from_numpy(weights)[:, None, None] * gradient).sum().backward()
        taken = knots.at(moments)
        assert taken is not None
        kernel.adam([taken])
        whole.step()
        torch.testing.assert_close(knots.values, whole.tensor.detach())
        assert knots.steps == whole.steps


def test_knot_adam_without_moments_returns_none() -> None:
    adam = KnotAdam(torch.ones(6, 4, 2), RATE, EPS)
    assert adam.at([]) is None
    assert adam.steps == 0
