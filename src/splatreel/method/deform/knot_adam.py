"""Adam for an array whose rows are added and removed, and for splines, of which a moment changes four knots only."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from splatreel.kernels import adam as kernel

DECAYS = 0.9, 0.999
DEFERRED_KNOTS, DEFERRED_SIZE = 12, 50_000
"""Numbers of knots and of control values from which steps without gradient are deferred. Few knots are nearly all in use."""
FULL_WEIGHT = np.ones(1, np.float32)

Restore = Callable[[], None]
"""Function that restores a saved state. It may be called repeatedly."""

Moment = tuple[int, np.ndarray, np.ndarray]
"""First of the four knots that a moment depends on, their weights [4] float32, and the gradient of the splines' values at that
moment."""


class Adam:
    """Adam optimizer of one array `parameter` [R, ...] float32, with the moments `mean` and `square` of its gradient."""

    def __init__(self, parameter: np.ndarray, rate: float, eps: float) -> None:
        self.rate = rate
        self.eps = eps
        mean, square = (np.zeros_like(parameter, np.float32) for _ in range(2))
        self._set(np.array(parameter, np.float32), mean, square, steps=0)

    def snapshot(self) -> Restore:
        """Copy the parameter and its moments."""
        steps, state = self.steps, [each.copy() for each in (self.parameter, self.mean, self.square)]

        def restore() -> None:
            self._set(*(each.copy() for each in state), steps=steps)

        return restore

    def follow(
        self, gradient: np.ndarray, first: int = 0, end: int | None = None, factors: np.ndarray = FULL_WEIGHT
    ) -> kernel.Step:
        """Return the step for a gradient [G, ...] of the rows from `first` on, see `kernel.Step`."""
        self.steps += 1
        moment = self.rate, *DECAYS, self.eps, self.steps
        last = len(self.mean) if end is None else end
        return kernel.Step(self._trained, gradient, factors, start=first, begin=0, end=last, moment=moment)

    def rewrite(
        self, of_parameter: Callable[[np.ndarray], np.ndarray], of_moment: Callable[[np.ndarray], np.ndarray]
    ) -> None:
        """Replace the parameter and its moments by functions of them."""
        self._set(of_parameter(self.parameter), of_moment(self.mean), of_moment(self.square), steps=self.steps)

    def _set(self, parameter: np.ndarray, mean: np.ndarray, square: np.ndarray, *, steps: int) -> None:
        self.parameter, self.mean, self.square = (np.ascontiguousarray(each) for each in (parameter, mean, square))
        self.steps = steps
        self._trained = kernel.Trained(self.parameter, self.mean, self.square)


class KnotAdam(Adam):
    """Adam optimizer of the control values of splines, [knots, rows, D].

    A moment changes four knots. The others only follow their momentum, and their steps are deferred until the values are read:
    the sum of missed steps has a closed form, up to the rounding of float32.
    """

    @property
    def values(self) -> np.ndarray:
        """Control values."""
        return self.current(0, len(self.mean))

    def current(self, first: int, last: int) -> np.ndarray:
        """Return the control values, of which the knots first..last have taken all steps."""
        missed = self._missed[:, first:last]
        if self._defers and missed[0].any():
            numbers, lengths, epsilons = missed
            mean_epsilons = np.divide(epsilons, lengths, out=np.full_like(lengths, self.eps), where=lengths > 0)
            columns = lengths, mean_epsilons, *(decay**numbers for decay in DECAYS)
            kernel.catch_up(kernel.Missed(self._trained, first, *(column.astype(np.float32) for column in columns)))
            missed[:] = 0
        return self.parameter

    def snapshot(self) -> Restore:
        """Copy the parameter and its moments."""
        self.current(0, len(self.mean))
        return super().snapshot()

    def rewrite(
        self, of_parameter: Callable[[np.ndarray], np.ndarray], of_moment: Callable[[np.ndarray], np.ndarray]
    ) -> None:
        """Replace the parameter and its moments by functions of them."""
        self.current(0, len(self.mean))
        super().rewrite(of_parameter, of_moment)

    def at(self, moments: Sequence[Moment], end: int | None = None) -> kernel.Step | None:
        """Return the step for gradients [rows, D] of some moments, with their knots; None without any.

        Knots from `end` on do not change.
        """
        if not moments:
            return None
        first, weights, gradient = moments[0]
        if len(moments) == 1:
            return self._defer(self.follow(gradient[None], first, end, weights), first + 4)
        first, last = min(knot for knot, _, _ in moments), max(knot for knot, _, _ in moments)
        total = np.zeros((last + 4 - first, *self.parameter.shape[1:]), np.float32)
        for knot, weights, gradient in moments:
            for k, weight in enumerate(weights.tolist()):
                total[knot - first + k] += weight * gradient
        return self._defer(self.follow(total, first, end), last + 4)

    def _set(self, parameter: np.ndarray, mean: np.ndarray, square: np.ndarray, *, steps: int) -> None:
        super()._set(parameter, mean, square, steps=steps)
        # The record of each knot's missed steps: their number, sum of lengths, and sum of epsilons weighted by length.
        self._missed = np.zeros((3, len(self.mean)))
        self._defers = self.mean.size >= DEFERRED_SIZE and len(self.mean) >= DEFERRED_KNOTS

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
