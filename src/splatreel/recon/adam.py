"""Adam for one tensor whose rows come and go, and for splines, of which a moment moves four knots only."""

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


class KnotAdam(Adam):
    """Of the control values of splines, tensor [knots, rows, D]; its gradients come for four knots at a time."""

    def __init__(self, tensor: Tensor, rate: float, eps: float) -> None:
        super().__init__(tensor, rate, eps)
        self.windows: list[tuple[int, Tensor]] = []

    @property
    def values(self) -> Tensor:
        return self.tensor.detach()

    def window(self, knot: int) -> Tensor:
        """The control values [4, rows, D] from a knot on: a leaf whose gradient the next step follows."""
        window = self.values[knot : knot + 4]
        if torch.is_grad_enabled():
            window.requires_grad_()
            self.windows.append((knot, window))
        return window

    def step(self, end: int | None = None) -> None:
        """Follow the gradients of all windows since the last step. end: knots from there on are left as they are."""
        known = [(knot, window.grad) for knot, window in self.windows if window.grad is not None]
        self.windows.clear()
        if len(known) == 1:
            ((first, gradient),) = known
            self.follow(gradient, first, end or len(self.tensor))
        elif known:
            first, last = min(knot for knot, _ in known), max(knot for knot, _ in known)
            total = self.values.new_zeros(last + 4 - first, *self.tensor.shape[1:])
            for knot, gradient in known:
                total[knot - first : knot - first + 4] += gradient
            self.follow(total, first, end or len(self.tensor))

    def rewrite(self, of_tensor: Callable[[Tensor], Tensor], of_moment: Callable[[Tensor], Tensor]) -> None:
        self.windows.clear()
        super().rewrite(of_tensor, of_moment)
