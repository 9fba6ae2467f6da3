"""Change of color and opacity of dynamic points within a group, beyond the paper.

Light and shadow pass over objects, flames flicker, and objects appear and disappear. Every point has a cubic B-spline in time,
as in `trajectory`, but with fewer knots, since fast changes are motion. At a cut, such as on a screen that changes its content,
the spline has a knot at every frame.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise

import numpy as np

from splatreel.kernels import adam, motion, splat
from splatreel.method.deform.knot_adam import KnotAdam, Restore
from splatreel.method.deform.spline import Spline

FRAMES_PER_KNOT = 5.0
RATES = np.array([8e-3, 8e-3, 8e-3, 8e-2], np.float32)
"""Learning rates of c_base and of the logit of the opacity."""
LAMBDA = np.array([3e-3, 3e-3, 3e-3, 1e-4], np.float32)
"""Weights of the mean absolute change. A change must pay for its bytes."""
CUT_GRAY_LEVELS, CUT_RATIO, CUT_SHARE = 40, 1.5, 0.002
"""A pixel changes strongly if it changes by `CUT_GRAY_LEVELS`. At a cut, `CUT_RATIO` times as many pixels do as in the frames
before and after, and at least the share `CUT_SHARE` of all."""


class Appearance:
    """Change of color and opacity of N points over the frames of a group."""

    def __init__(self, frames: int, count: int, start: np.ndarray | None = None, cuts: Iterable[int] = ()) -> None:
        """Create splines. `start` [T, N, 3]: initial change of c_base; None means none. `cuts`: see `detect_cuts`."""
        bends = {frame for cut in cuts for frame in (cut - 1, cut)}
        self.spline = Spline(frames, bends, FRAMES_PER_KNOT)
        controls = np.zeros((self.spline.knots, count, 4), np.float32)
        if start is not None:
            controls[..., :3] = self.spline.fit(start) / RATES[:3]
        self.adam = KnotAdam(controls, rate=1.0, eps=1e-12)

    @property
    def controls(self) -> np.ndarray:
        """Control values [knots, N, 4], in units of the learning rates."""
        return self.adam.values

    def prepare(self, times: Iterable[float]) -> None:
        """Take the optimizer steps that `at` waits for. It then only reads the splines, so that threads can share them."""
        for knot in (self.spline.at(time)[0] for time in times):
            self.adam.current(knot, knot + 4)

    def at(self, time: float) -> np.ndarray:
        """Return the change [N, 4] of c_base and of the logit of the opacity at a time, in frames of the group."""
        knot, weights = self.spline.at(time)
        shade = motion.spline(self.adam.current(knot, knot + 4)[knot : knot + 4], weights)
        shade *= RATES
        return shade

    @property
    def highest(self) -> np.ndarray:
        """Maximum change [N] of the logit of the opacity. A spline stays within its control values."""
        return self.controls[..., 3].max(0) * RATES[3]

    def steps(self, time: float, shade: np.ndarray, d_shade: np.ndarray, share: float, pace: float) -> list[adam.Step]:
        """Return the optimizer steps for a gradient d_shade [N, 4], which is changed, to `shade` [N, 4], the result of `at(time)`.

        Changes also pay `LAMBDA` times their mean absolute value.
        """
        adam.add_signs(shade, LAMBDA / np.float32(max(shade.size, 1)), d_shade)
        d_shade *= RATES
        self.adam.rate = pace * 0.05**share
        taken = self.adam.at([(*self.spline.at(time), d_shade)])
        return [] if taken is None else [taken]

    def snapshot(self) -> Restore:
        """Copy everything that training changes."""
        return self.adam.snapshot()

    def check(self) -> None:
        """Raise a `GaussiansError` if a value is NaN or infinite."""
        splat.check_finite(shade=self.controls)

    def keep(self, index: np.ndarray) -> None:
        """Keep the rows of an index or mask."""
        self.adam.rewrite(lambda rows: rows[:, index], lambda rows: rows[:, index])

    def append(self, count: int, parents: np.ndarray | None) -> None:
        """Add points, see `Deformation.append`. New points do not change."""
        zeros = np.zeros((len(self.controls), count, 4), np.float32)
        added = zeros if parents is None else self.controls[:, parents]
        self.adam.rewrite(lambda rows: np.concatenate([rows, added], 1), lambda rows: np.concatenate([rows, zeros], 1))


def detect_cuts(images: np.ndarray) -> list[int]:
    """Return the frames of images [T, C, H, W, 3] uint8 in which far more pixels change strongly than before and after.

    Motion changes about as many pixels in neighboring frames. A quarter of the pixels is read.
    """
    few = images[:, :, ::2, ::2]
    shares = [_strong(before, now) for before, now in pairwise(few)]
    around = [max(shares[max(i - 1, 0) : i] + shares[i + 1 : i + 2], default=1.0) for i in range(len(shares))]
    cut = [share > max(CUT_RATIO * other, CUT_SHARE) for share, other in zip(shares, around, strict=True)]
    return [i + 1 for i in range(len(cut)) if cut[i]]


def _strong(before: np.ndarray, now: np.ndarray) -> float:
    """Return the share of the pixels of all cameras that change strongly."""
    changed = np.maximum(before, now) - np.minimum(before, now) > CUT_GRAY_LEVELS
    return float((changed[..., 0] | changed[..., 1] | changed[..., 2]).mean())
