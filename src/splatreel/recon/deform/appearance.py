"""How the color and the opacity of dynamic points change within a group: what motion cannot tell (beyond the paper).

Light and shadow pass over things, flames flicker, things come and go. Every point has a cubic B-spline in time of its own, as
`trajectory` has for motion, with fewer knots: what changes fast is motion. But where much changes at once, as on a screen that shows
something else, it has one in every frame.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor

from splatreel.kernels import adam, motion, splat
from splatreel.recon.deform.adam import KnotAdam, Restore
from splatreel.recon.deform.spline import Spline

FRAMES_PER_KNOT = 5.0
RATES = (8e-3, 8e-3, 8e-3, 8e-2)
"""Learning rates of c_base and of the logit of the opacity."""
LAMBDA = (3e-3, 3e-3, 3e-3, 1e-4)
"""Weights of the mean absolute change: it is worth its bytes only where it shows."""
CUT_GRAY_LEVELS, CUT_RATIO, CUT_SHARE = 40, 1.5, 0.002
"""Gray levels by which a pixel changes strongly. At a cut CUT_RATIO times as many do as in the frames before and after, and at
least the share CUT_SHARE of all."""


class Appearance:
    """Changes of N points over the frames of a group. controls: [knots, N, 4] in units of the learning rates.

    start: [T, N, 3] what c_base gains at every frame, at first; nothing by default. cuts: frames of `detect_cuts`.
    """

    def __init__(
        self, frames: int, count: int, device: torch.device, start: Tensor | None = None, cuts: Iterable[int] = ()
    ) -> None:
        bends = {frame for cut in cuts for frame in (cut - 1, cut)}
        self.spline = Spline(frames, bends, FRAMES_PER_KNOT)
        self.rates, self.weights = torch.tensor(RATES, device=device), torch.tensor(LAMBDA, device=device)
        controls = torch.zeros(self.spline.knots, count, 4, device=device)
        if start is not None:
            controls[..., :3] = self.spline.fit(start) / self.rates[:3]
        self.adam = KnotAdam(controls, rate=1.0, eps=1e-12)
        self.moments: list[tuple[int, np.ndarray, Tensor]] = []

    @property
    def controls(self) -> Tensor:
        return self.adam.values

    def at(self, frame: float) -> Tensor:
        """[N, 4] gains on c_base and on the logit of the opacity: a leaf, whose gradient the next step follows."""
        knot, weights = self.spline.at(frame)
        shade = motion.spline(self.controls, knot, weights) * self.rates
        if torch.is_grad_enabled():
            self.moments.append((knot, weights, shade.requires_grad_()))
        return shade

    @property
    def highest(self) -> Tensor:
        """[N] the most that the logit of the opacity gains at any time: a spline stays within its controls."""
        return self.controls[..., 3].amax(0) * self.rates[3]

    def step(self, share: float, pace: float = 1.0) -> None:
        """As `Deformation.step`. Every change also costs its share of the mean of `LAMBDA` times its size."""
        known = [
            (knot, weights, (shade.grad + shade.detach().sign() * (self.weights / shade.numel())) * self.rates)
            for knot, weights, shade in self.moments
            if shade.grad is not None
        ]
        self.moments.clear()
        self.adam.rate = pace * 0.05**share
        taken = self.adam.at(known)
        if taken is not None:
            adam.adam([taken])

    def snapshot(self) -> Restore:
        """As `Deformation.snapshot`."""
        controls = self.adam.snapshot()

        def restore() -> None:
            controls()
            self.moments.clear()

        return restore

    def check(self) -> None:
        """Raises `GaussiansError` if a value is NaN or infinite."""
        splat.check_finite(shade=self.controls)

    def keep(self, index: Tensor) -> None:
        self.moments.clear()
        self.adam.rewrite(lambda rows: rows[:, index], lambda rows: rows[:, index])

    def append(self, count: int, parents: Tensor | None) -> None:
        """As `Deformation.append`: new points do not change."""
        self.moments.clear()
        added = self.controls[:, parents] if parents is not None else None
        zeros = self.controls.new_zeros(len(self.controls), count, 4)
        self.adam.rewrite(
            lambda rows: torch.cat([rows, zeros if added is None else added], 1),
            lambda rows: torch.cat([rows, zeros], 1),
        )


def detect_cuts(images: Tensor) -> list[int]:
    """Frames of images [T, C, H, W, 3] uint8 in which far more pixels change strongly than in those before and after.

    What moves changes about as many in neighboring frames. A quarter of the pixels is looked at.
    """
    few = images[:, :, ::2, ::2]
    shares = [_strong(before.short(), now.short()) for before, now in pairwise(few)]
    around = [max(shares[max(i - 1, 0) : i] + shares[i + 1 : i + 2], default=1.0) for i in range(len(shares))]
    cut = [share > max(CUT_RATIO * other, CUT_SHARE) for share, other in zip(shares, around, strict=True)]
    return [i + 1 for i in range(len(cut)) if cut[i]]


def _strong(before: Tensor, now: Tensor) -> float:
    """Share of the pixels of all cameras that change strongly."""
    return float(((now - before).abs().amax(-1) > CUT_GRAY_LEVELS).float().mean())
