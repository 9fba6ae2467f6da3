"""Adam for a tensor whose rows are added and removed, and for splines, of which a moment changes four knots only."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np
import torch
from torch import Tensor

from splatreel.kernels import adam as kernel

DECAYS = 0.9, 0.999
DEFERRED_KNOTS, DEFERRED_SIZE = 12, 50_000
"""Numbers of knots and of control values from which steps without gradient are deferred. Few knots are nearly all in use."""
FULL_WEIGHT = np.ones(1, np.float32)

Restore = Callable[[], None]
"""Function that restores a saved state. It may be called repeatedly."""

Moment = tuple[int, np.ndarray, Tensor]
"""First of the four knots that a moment depends on, their weights [4] float32, and the gradient of the splines' values at that
moment."""


class Adam:
    """Adam optimizer of one tensor.

    Attributes:
        tensor: Leaf tensor that is trained.
        mean: First moment of its gradient.
        square: Second moment of its gradient.
        rate: Learning rate.
        steps: Number of steps taken.
    """

    def __init__(self, tensor: Tensor, rate: float, eps: float) -> None:
        """Copy a tensor and start its moments at zero."""
        self.tensor = tensor.detach().clone().contiguous().requires_grad_(True)
        self.mean, self.square = (torch.zeros_like(tensor, requires_grad=False) for _ in range(2))
        self.rate = rate
        self.eps = eps
        self.steps = 0
        self._trained = kernel.Trained(self.tensor.detach(), self.mean, self.square)

    def snapshot(self) -> Restore:
        """Copy the tensor and its moments."""
        steps, state = self.steps, [each.detach().clone() for each in (self.tensor, self.mean, self.square)]

        def restore() -> None:
            self.steps = steps
            self.tensor, self.mean, self.square = (each.clone() for each in state)
            self.rewrite(lambda tensor: tensor, lambda moment: moment)

        return restore

    def step(self) -> None:
        """Follow the gradient of the tensor, if it has one, and clear it."""
        step([self])

    def take(self) -> kernel.Step | None:
        """Return the step that follows the tensor's gradient, and clear the gradient; return None if there is none."""
        gradient, self.tensor.grad = self.tensor.grad, None
        return None if gradient is None else self.follow(gradient, 0)

    def follow(
        self, gradient: Tensor, first: int, end: int | None = None, factors: np.ndarray = FULL_WEIGHT
    ) -> kernel.Step:
        """Return the step for a gradient [G, ...] of the rows from `first` on, see `kernel.Step`."""
        self.steps += 1
        moment = self.rate, *DECAYS, self.eps, self.steps
        return kernel.Step(self._trained, gradient, factors, first, len(self.mean) if end is None else end, moment)

    def rewrite(self, of_tensor: Callable[[Tensor], Tensor], of_moment: Callable[[Tensor], Tensor]) -> None:
        """Replace the tensor and its moments by functions of them."""
        self.tensor = of_tensor(self.tensor.detach()).contiguous().requires_grad_(True)
        self.mean = of_moment(self.mean).contiguous()
        self.square = of_moment(self.square).contiguous()
        self._trained = kernel.Trained(self.tensor.detach(), self.mean, self.square)


class KnotAdam(Adam):
    """Adam optimizer of the control values of splines, [knots, rows, D].

    A moment changes four knots. The others only follow their momentum, and their steps are deferred until the values are read:
    the sum of missed steps has a closed form, up to the rounding of float32.
    """

    def __init__(self, tensor: Tensor, rate: float, eps: float) -> None:
        """Copy a tensor and start its moments at zero."""
        super().__init__(tensor, rate, eps)
        self._restart_missed()

    @property
    def values(self) -> Tensor:
        """Control values, without gradient."""
        return self.current(0, len(self.mean))

    def current(self, first: int, last: int) -> Tensor:
        """Return the control values, without gradient, of which the knots first..last have taken all steps."""
        missed = self._missed[:, first:last]
        if self._defers and missed[0].any():
            numbers, lengths, epsilons = missed
            mean_epsilons = np.divide(epsilons, lengths, out=np.full_like(lengths, self.eps), where=lengths > 0)
            columns = lengths, mean_epsilons, *(decay**numbers for decay in DECAYS)
            kernel.catch_up(kernel.Missed(self._trained, first, *(column.astype(np.float32) for column in columns)))
            missed[:] = 0
        return self._trained.parameter

    def snapshot(self) -> Restore:
        """Copy the tensor and its moments."""
        self.current(0, len(self.mean))
        return super().snapshot()

    def rewrite(self, of_tensor: Callable[[Tensor], Tensor], of_moment: Callable[[Tensor], Tensor]) -> None:
        """Replace the tensor and its moments by functions of them."""
        self.current(0, len(self.mean))
        super().rewrite(of_tensor, of_moment)
        self._restart_missed()

    def at(self, moments: Sequence[Moment], end: int | None = None) -> kernel.Step | None:
        """Return the step for the gradients [rows, D] of some moments; None without moments.

        Args:
            moments: Gradients and the knots they belong to.
            end: First knot that is not changed; None changes all.
        """
        if not moments:
            return None
        first, weights, gradient = moments[0]
        if len(moments) == 1:
            return self._defer(self.follow(gradient[None], first, end, weights), first + 4)
        first, last = min(knot for knot, _, _ in moments), max(knot for knot, _, _ in moments)
        total = self.mean.new_zeros(last + 4 - first, *self.tensor.shape[1:])
        for knot, weights, gradient in moments:
            for k, weight in enumerate(weights.tolist()):
                total[knot - first + k].add_(gradient, alpha=weight)
        return self._defer(self.follow(total, first, end), last + 4)

    def _restart_missed(self) -> None:
        """Start the record of each knot's missed steps: their number, sum of lengths, and sum of epsilons weighted by length."""
        self._missed = np.zeros((3, len(self.mean)))
        large = self.mean.numel() >= DEFERRED_SIZE and len(self.mean) >= DEFERRED_KNOTS
        self._defers = large and self.mean.device.type == "cpu"  # starting operations takes longer on a GPU

    def _defer(self, step: kernel.Step, last: int) -> kernel.Step:
        """Restrict a step to the knots step.start..last with a gradient, and record that the others miss it."""
        if not self._defers:
            return step
        last = min(last, step.end)
        self.current(step.start, last)
        rate, decay, square_decay, eps, number = step.moment
        rate, correction = rate / (1 - decay**number), math.sqrt(1 - square_decay**number)
        for others in (slice(step.start), slice(last, step.end)):
            missed, lengths, epsilons = self._missed[:, others]
            missed += 1
            root = correction / square_decay ** (0.5 * missed)
            length = rate * decay**missed * root
            lengths += length
            epsilons += length * (eps * root)
        return step._replace(begin=step.start, end=last)


def merge_snapshots(parts: Iterable[Restore]) -> Restore:
    """Combine several restore functions into one."""
    parts = list(parts)

    def restore() -> None:
        for part in parts:
            part()

    return restore


def step(adams: Iterable[Adam]) -> None:
    """Follow the gradients of several tensors in one pass."""
    kernel.adam([taken for adam in adams if (taken := adam.take()) is not None])
