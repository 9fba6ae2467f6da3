"""Adam for one tensor whose rows come and go."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from splatreel.kernels import splat

DECAYS = 0.9, 0.999


class Adam:
    """tensor: a leaf; mean, square: the moments of its gradient, of the same shape; steps: taken so far. rate: the learning rate."""

    def __init__(self, tensor: Tensor, rate: float, eps: float) -> None:
        self.tensor = tensor.detach().clone().contiguous().requires_grad_(True)
        self.mean, self.square = (torch.zeros_like(tensor, requires_grad=False) for _ in range(2))
        self.rate, self.eps, self.steps = rate, eps, 0

    def step(self) -> None:
        """Follow the gradient of the tensor, if it has one, and clear it."""
        gradient, self.tensor.grad = self.tensor.grad, None
        if gradient is not None:
            self.follow(gradient, 0, len(self.tensor))

    def follow(self, gradient: Tensor, first: int, end: int) -> None:
        """Take a step by a gradient [R, ...] of the rows from `first` on; of the others, those before `end` go on by their momentum."""
        self.steps += 1
        rows = self.tensor.detach()[:end], self.mean[:end], self.square[:end]
        splat.adam(*rows, gradient[: max(end - first, 0)], first, (self.rate, *DECAYS, self.eps, self.steps))

    def rewrite(self, of_tensor: Callable[[Tensor], Tensor], of_moment: Callable[[Tensor], Tensor]) -> None:
        """Replace the tensor and its moments by what is made of them."""
        self.tensor = of_tensor(self.tensor.detach()).contiguous().requires_grad_(True)
        self.mean, self.square = of_moment(self.mean).contiguous(), of_moment(self.square).contiguous()
