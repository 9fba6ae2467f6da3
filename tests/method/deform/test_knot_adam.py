"""Adam for changing rows and for knots of splines."""

import numpy as np
import pytest
import torch

from splatreel.kernels import adam as kernel
from splatreel.method.deform.knot_adam import Adam, KnotAdam

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


@pytest.mark.parametrize(("size", "close"), [(1e-2, 2e-6), (1e-9, 3e-5)])
def test_deferred_steps_equal_steps_one_by_one(size: float, close: float) -> None:
    """Knots that no moment changes for a while end where steps without gradient would have taken them.

    Steps for gradients near eps may differ by a thousandth.
    """
    rng, shape, eps = np.random.default_rng(0), (30, 700, 3), 1e-12
    start = torch.from_numpy(rng.normal(size=shape).astype(np.float32))
    knots, whole = KnotAdam(start, RATE, eps), Adam(start, RATE, eps)
    weights, end = np.array([0.1, 0.5, 0.3, 0.1], np.float32), 8
    stepped = []
    for number in range(240):
        knots.rate = whole.rate = RATE * 0.1 ** (number / 240)
        end = min(end + (number % 5 == 0), len(start))
        turn = rng.integers(0, end - 3, 1 + (number % 7 == 0)).tolist()
        gradients = [torch.from_numpy(rng.normal(0, size, shape[1:]).astype(np.float32)) for _ in turn]
        total = torch.zeros(shape)
        for knot, gradient in zip(turn, gradients, strict=True):
            total[knot : knot + 4] += torch.from_numpy(weights)[:, None, None] * gradient
        taken = knots.at([(knot, weights, gradient) for knot, gradient in zip(turn, gradients, strict=True)], end)
        assert taken is not None
        stepped.append(taken.end - taken.begin)
        kernel.adam([taken])
        kernel.adam([whole.follow(total, 0, end)])
        knot = int(rng.integers(0, end - 3))
        some = slice(knot, knot + 4)
        torch.testing.assert_close(
            knots.current(knot, knot + 4)[some], whole.tensor.detach()[some], rtol=1e-5, atol=close
        )
        if number == 150:
            restore = knots.snapshot()
            restore()
            knots.rewrite(lambda rows: rows[:, 50:], lambda rows: rows[:, 50:])
            whole.rewrite(lambda rows: rows[:, 50:], lambda rows: rows[:, 50:])
            shape = (30, 650, 3)
    torch.testing.assert_close(knots.values, whole.tensor.detach(), rtol=1e-5, atol=close)
    torch.testing.assert_close(knots.mean, whole.mean, rtol=1e-4, atol=1e-6 * size)
    assert np.mean(stepped) < 8, "most knots are left alone"


@pytest.mark.parametrize("knots", [5, 30])
def test_small_or_short_splines_are_not_deferred(knots: int) -> None:
    """Deferring costs more than it saves where nearly all knots are in use."""
    adam = KnotAdam(torch.ones(knots, 10, 2), RATE, EPS)
    taken = adam.at([(0, np.ones(4, np.float32), torch.ones(10, 2))])
    assert taken is not None
    assert (taken.begin, taken.end) == (0, knots)
