"""Rows that come and go, and knots that a moment moves."""

import torch

from splatreel.recon.adam import Adam, KnotAdam

RATE, EPS = 0.02, 1e-15


def test_what_has_no_gradient_stays_and_forgets_nothing():
    adam = Adam(torch.ones(5, 2), RATE, EPS)
    adam.step()
    assert adam.steps == 0
    adam.tensor.sum().backward()
    adam.step()
    assert adam.steps == 1
    assert adam.tensor.grad is None
    torch.testing.assert_close(adam.tensor.detach(), torch.full((5, 2), 1 - RATE))


def test_rows_after_the_end_are_left_alone():
    adam = Adam(torch.ones(5, 2), RATE, EPS)
    adam.follow(torch.ones(4, 2), 1, end=3)
    torch.testing.assert_close(adam.tensor[:, 0].detach(), torch.tensor([1, 1 - RATE, 1 - RATE, 1, 1]))
    assert not adam.mean[3:].any()


def test_windows_have_the_steps_of_all_knots() -> None:
    """Several moments between two steps add up, wherever their knots overlap."""
    start = torch.randn(9, 5, 3, generator=torch.Generator().manual_seed(0))
    windows, whole = KnotAdam(start, RATE, EPS), Adam(start, RATE, EPS)
    for knots in ((0,), (2, 3, 5), (1, 5), (4, 4)):
        for knot in knots:
            weights = torch.arange(1.0, 5)[:, None, None] + knot
            (windows.window(knot) * weights).sum().backward()
            (whole.tensor[knot : knot + 4] * weights).sum().backward()
        windows.step()
        whole.step()
        assert not windows.windows
        torch.testing.assert_close(windows.values, whole.tensor.detach())
        assert windows.steps == whole.steps


def test_windows_looked_at_without_gradients_or_before_rows_changed_count_for_nothing() -> None:
    adam = KnotAdam(torch.ones(6, 4, 2), RATE, EPS)
    with torch.no_grad():
        assert not adam.window(1).requires_grad
    adam.window(2).sum().backward()
    adam.rewrite(lambda rows: rows[:, :3], lambda rows: rows[:, :3])
    adam.window(0)
    adam.step()
    assert adam.steps == 0
    assert adam.values.shape == adam.mean.shape == (6, 3, 2)
    assert bool((adam.values == 1).all())
