"""Adam against torch's own, over steps with and without gradients."""

import pytest
import torch

from splatreel.kernels import splat, twin

RATE, EPS = 0.02, 1e-15


@pytest.mark.parametrize("kernel", [splat.adam, twin.adam])
@pytest.mark.parametrize("shape", [(1,), (7, 3), (90, 45, 3), (25, 300, 7), (3, 0, 3)])
def test_steps_are_those_of_torch(kernel, shape):
    generator = torch.Generator().manual_seed(0)
    ours = torch.randn(shape, generator=generator)
    theirs = ours.clone().requires_grad_()
    optimizer = torch.optim.Adam([theirs], lr=RATE, eps=EPS)
    mean, square = torch.zeros(shape), torch.zeros(shape)
    for number in range(1, 9):
        first = number % len(ours)
        gradient = torch.randn((min(4, len(ours) - first), *shape[1:]), generator=generator)
        theirs.grad = torch.zeros(shape)
        theirs.grad[first : first + len(gradient)] = gradient
        optimizer.step()
        kernel(ours, mean, square, gradient, first, (RATE, 0.9, 0.999, EPS, number))
        torch.testing.assert_close(ours, theirs.detach(), rtol=1e-5, atol=1e-5)
    torch.testing.assert_close(mean, optimizer.state[theirs]["exp_avg"], rtol=1e-4, atol=1e-7)
    torch.testing.assert_close(square, optimizer.state[theirs]["exp_avg_sq"], rtol=1e-4, atol=1e-7)
