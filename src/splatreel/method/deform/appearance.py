"""Change of color and opacity of dynamic points within a group, beyond the paper.

Light and shadow pass over objects, flames flicker, and objects appear and disappear. Every point has a cubic B-spline in time,
as in `trajectory`, but with fewer knots, since fast changes are motion. At a cut, such as on a screen that changes its content,
the spline has a knot at every frame.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor

from splatreel.kernels import adam, motion, splat
from splatreel.method.deform.knot_adam import KnotAdam, Moment, Restore
from splatreel.method.deform.spline import Spline

FRAMES_PER_KNOT = 5.0
RATES = (8e-3, 8e-3, 8e-3, 8e-2)
"""Learning rates of c_base and of the logit of the opacity."""
LAMBDA = (3e-3, 3e-3, 3e-3, 1e-4)
"""Weights of the mean absolute change. A change must pay for its bytes."""
CUT_GRAY_LEVELS, CUT_RATIO, CUT_SHARE = 40, 1.5, 0.002
"""A pixel changes strongly if it changes by `CUT_GRAY_LEVELS`. At a cut, `CUT_RATIO` times as many pixels do as in the frames
before and after, and at least the share `CUT_SHARE` of all."""


class Appearance:
    """Change of color and opacity of N points over the frames of a group."""

    def __init__(
        self, frames: int, count: int, device: torch.device, start: Tensor | None = None, cuts: Iterable[int] = ()
    ) -> None:
        """Create splines.

        Args:
            frames: Number of frames, T.
            count: Number of points, N.
            device: Device of the tensors.
            start: [T, N, 3] initial change of c_base at every frame; None means no change.
            cuts: Result of `detect_cuts`.
        """
        bends = {frame for cut in cuts for frame in (cut - 1, cut)}
        self.spline = Spline(frames, bends, FRAMES_PER_KNOT)
        self.rates = torch.tensor(RATES, device=device)
        self.weights = torch.tensor(LAMBDA, device=device)
        controls = torch.zeros(self.spline.knots, count, 4, device=device)
        if start is not None:
            controls[..., :3] = self.spline.fit(start) / self.rates[:3]
        self.adam = KnotAdam(controls, rate=1.0, eps=1e-12)
        self.moments: list[tuple[int, np.ndarray, Tensor]] = []

    @property
    def controls(self) -> Tensor:
        """Control values [knots, N, 4], in units of the learning rates."""
        return self.adam.values

    def at(self, frame: float) -> Tensor:
        """Return the change [N, 4] of c_base and of the logit of the opacity: a leaf, whose gradient the next step follows."""
        knot, weights = self.spline.at(frame)
        shade = motion.spline(self.adam.current(knot, knot + 4), knot, weights) * self.rates
        if torch.is_grad_enabled():
            self.moments.append((knot, weights, shade.requires_grad_()))
        return shade

    @property
    def highest(self) -> Tensor:
        """Maximum change [N] of the logit of the opacity. A spline stays within its control values."""
        return self.controls[..., 3].amax(0) * self.rates[3]

    def step(self, share: float, pace: float = 1.0) -> None:
        """Take an optimizer step, see `Deformation.step`. Changes also pay `LAMBDA` times their mean absolute value."""
        known = [
            (knot, weights, (shade.grad + shade.detach().sign() * (self.weights / shade.numel())) * self.rates)
            for knot, weights, shade in self.moments
            if shade.grad is not None
        ]
        self.moments.clear()
        adam.adam(self.follow(known, share, pace))

    def follow(self, known: Sequence[Moment], share: float, pace: float) -> list[adam.Step]:
        """Return the optimizer step for gradients at some moments, or nothing. share, pace: see `Deformation.step`."""
        self.adam.rate = pace * 0.05**share
        taken = self.adam.at(known)
        return [] if taken is None else [taken]

    def snapshot(self) -> Restore:
        """Copy everything that training changes."""
        controls = self.adam.snapshot()

        def restore() -> None:
            controls()
            self.moments.clear()

        return restore

    def check(self) -> None:
        """Check all values.

        Raises:
            GaussiansError: If a value is NaN or infinite.
        """
        splat.check_finite(shade=self.controls)

    def keep(self, index: Tensor) -> None:
        """Keep the rows of an index or mask."""
        self.moments.clear()
        self.adam.rewrite(lambda rows: rows[:, index], lambda rows: rows[:, index])

    def append(self, count: int, parents: Tensor | None) -> None:
        """Add points, see `Deformation.append`. New points do not change."""
        self.moments.clear()
        added = self.controls[:, parents] if parents is not None else None
        zeros = self.controls.new_zeros(len(self.controls), count, 4)
        self.adam.rewrite(
            lambda rows: torch.cat([rows, zeros if added is None else added], 1),
            lambda rows: torch.cat([rows, zeros], 1),
        )


def detect_cuts(images: Tensor) -> list[int]:
    """Return the frames of images [T, C, H, W, 3] uint8 in which far more pixels change strongly than before and after.

    Motion changes about as many pixels in neighboring frames. A quarter of the pixels is read.
    """
    few = images[:, :, ::2, ::2]
    shares = [_strong(before.short(), now.short()) for before, now in pairwise(few)]
    around = [max(shares[max(i - 1, 0) : i] + shares[i + 1 : i + 2], default=1.0) for i in range(len(shares))]
    cut = [share > max(CUT_RATIO * other, CUT_SHARE) for share, other in zip(shares, around, strict=True)]
    return [i + 1 for i in range(len(cut)) if cut[i]]


def _strong(before: Tensor, now: Tensor) -> float:
    """Return the share of the pixels of all cameras that change strongly."""
    return float(((now - before).abs().amax(-1) > CUT_GRAY_LEVELS).float().mean())
