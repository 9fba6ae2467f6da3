"""Adam compared with torch's Adam, over steps with and without gradients."""

import numpy as np
import pytest
import torch

from splatreel.kernels import adam, twin

RATE, EPS = 0.02, 1e-15
ONCE = np.ones(1, np.float32)


@pytest.mark.parametrize("kernel", [adam.adam, twin.adam])
@pytest.mark.parametrize("shape", [(1,), (7, 3), (90, 45, 3), (25, 300, 7), (3, 0, 3)])
def test_adam_equals_torch(kernel, shape):
    generator = torch.Generator().manual_seed(0)
    ours = torch.randn(shape, generator=generator)
    theirs = ours.clone().requires_grad_()
    optimizer = torch.optim.Adam([theirs], lr=RATE, eps=EPS)
    trained = adam.Trained(ours, torch.zeros(shape), torch.zeros(shape))
    for number in range(1, 9):
        first = number % len(ours)
        gradient = torch.randn((min(4, len(ours) - first), *shape[1:]), generator=generator)
        theirs.grad = torch.zeros(shape)
        theirs.grad[first : first + len(gradient)] = gradient
        optimizer.step()
        moment = RATE, 0.9, 0.999, EPS, number
        kernel([adam.Step(trained, gradient, ONCE, first, len(ours), moment)])
        torch.testing.assert_close(ours, theirs.detach(), rtol=1e-5, atol=1e-5)
    torch.testing.assert_close(trained.mean, optimizer.state[theirs]["exp_avg"], rtol=1e-4, atol=1e-7)
    torch.testing.assert_close(trained.square, optimizer.state[theirs]["exp_avg_sq"], rtol=1e-4, atol=1e-7)


@pytest.mark.parametrize("kernel", [adam.adam, twin.adam])
def test_adam_steps_many_tensors_and_shared_gradients(kernel):
    """One call steps a whole tensor and knots that share one gradient times factors, across chunks and past the end."""
    generator = torch.Generator().manual_seed(0)
    factors = np.array([0.1, 0.5, -0.3, 0.2], np.float32)
    shapes = (5000, 3), (9, 700, 4), (0, 3)
    ours = [torch.randn(shape, generator=generator) for shape in shapes]
    theirs = [tensor.clone().requires_grad_() for tensor in ours]
    optimizer = torch.optim.Adam(theirs, lr=RATE, eps=EPS)
    trained = [adam.Trained(tensor, torch.zeros_like(tensor), torch.zeros_like(tensor)) for tensor in ours]
    for number, first in enumerate((0, 3, 5, 7), 1):
        whole, shared = torch.randn(5000, 3, generator=generator), torch.randn(1, 700, 4, generator=generator)
        theirs[0].grad, theirs[1].grad = whole, torch.zeros(shapes[1])
        theirs[2].grad = torch.zeros(0, 3)
        for k, factor in enumerate(factors.tolist()):
            if first + k < 9:
                theirs[1].grad[first + k] = factor * shared[0]
        optimizer.step()
        parts = zip(trained, (whole, shared, theirs[2].grad), (ONCE, factors, ONCE), (0, first, 0), strict=True)
        moment = RATE, 0.9, 0.999, EPS, number
        kernel([adam.Step(t, g, f, start, len(t.mean), moment) for t, g, f, start in parts])
        for a, b in zip(ours, theirs, strict=True):
            torch.testing.assert_close(a, b.detach(), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("kernel", [adam.catch_up, twin.catch_up])
def test_catch_up_takes_missed_steps(kernel):
    """Rows that missed 0, 1 and 20 steps end where Adam without gradient takes them; other rows are left alone."""
    generator = torch.Generator().manual_seed(0)
    start, mean = (torch.randn(5, 40, 3, generator=generator) for _ in range(2))
    square = mean**2 + 1e-3
    ours, theirs = ([value.clone() for value in (start, mean, square)] for _ in range(2))
    counts, lengths, epsilons = np.array([0, 1, 20]), np.zeros(3), np.full(3, EPS)
    for number in range(1, 21):
        for row in np.flatnonzero(counts >= number):
            trained = adam.Trained(*(value[1 + row][None] for value in theirs))
            twin.adam([twin.Step(trained, torch.zeros(0, 40, 3), ONCE, 0, 1, (RATE, 0.9, 0.999, EPS, 50 + number))])
            scale = np.sqrt(1 - 0.999 ** (50 + number)) / (1 - 0.9 ** (50 + number))
            lengths[row] += RATE * scale * (0.9 / np.sqrt(0.999)) ** number
    decays = [np.power(decay, counts) for decay in (0.9, 0.999)]
    kernel(adam.Missed(adam.Trained(*ours), 1, *(column.astype(np.float32) for column in (lengths, epsilons, *decays))))
    for a, b in zip(ours, theirs, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-5, atol=1e-6)
    for value, before in zip(ours, (start, mean, square), strict=True):
        assert torch.equal(value[[0, 4]], before[[0, 4]])
