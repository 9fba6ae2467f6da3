"""Which points a keyframe has: 3DGS's densification in the first part of training, and pruning."""

from __future__ import annotations

import torch
from torch import Tensor

from splatreel.config import KeyframeConfig
from splatreel.recon.train.density import (
    CULL_OPACITY,
    GROWTH_GRADIENT,
    GradientMeter,
    children,
    select_growth,
    too_large,
)
from splatreel.recon.train.losses import GROWTH
from splatreel.recon.train.pictures import Pictures
from splatreel.recon.train.points import TrainablePoints
from splatreel.recon.train.render import Comparable, View, relative_distances

PRUNE_EVERY = 500
"""Iterations between two that drop points, once none are added."""

SPLIT_FROM = 0.01
"""Scale from which a point is split and not cloned, in typical viewing distances."""


class KeyframeDensity:
    """Changes the rows of `points`. distances: [N], see `relative_distances`; ones before any pictures are known."""

    def __init__(self, points: TrainablePoints, config: KeyframeConfig, max_points: int, seed: int) -> None:
        self.points, self.config, self.max_points = points, config, max_points
        self.generator = torch.Generator().manual_seed(seed)
        self.distances = torch.ones(len(points), device=points.means.device)

    def restart(self, pictures: Pictures) -> None:
        """Begin to measure anew, after points have come or gone or with other pictures."""
        self.meter = GradientMeter(len(self.points), self.points.means.device)
        self.distances = relative_distances(
            self.points.means, pictures.views, pictures.unit, self.config.far_step_scale
        )

    def update(
        self, done: int, share: float, drawing: Comparable, view: View, pictures: Pictures, settled: bool
    ) -> None:
        """After an iteration: let points come and go where it is time for it.

        done: iterations with this one. share: 0..1, that much of training. settled: values are averaged, no point goes any more.
        """
        grad, every = drawing.means2d.grad, self.config.densify_every
        assert grad is not None
        if share <= GROWTH:
            self.meter.add(grad[: drawing.moving], view.width, view.height)
            if done % every == 0 and done >= 2 * every:
                self.densify(pictures.unit, share)
                self.restart(pictures)
        elif done % PRUNE_EVERY == 0 and not settled:
            self.prune(pictures.unit, share)
            self.restart(pictures)

    def densify(self, unit: float, share: float) -> None:
        """Clone small points that the image pulls at, split large ones, and prune."""
        points = self.points
        points.check()
        grow = select_growth(self.meter, GROWTH_GRADIENT, self.max_points - len(points))
        dropped = self._dropped(unit, share)
        large = points.scales.detach().amax(1) > SPLIT_FROM * unit
        split, clone = grow & large & ~dropped, grow & ~large & ~dropped
        clones, halves = points.rows(clone), children(points, split, self.generator)
        points.keep(~(dropped | split))
        points.append({name: torch.cat([clones[name], halves[name]]) for name in clones})

    def prune(self, unit: float, share: float) -> None:
        """Drop points, but never all."""
        self.points.check()
        dropped = self._dropped(unit, share)
        if bool(dropped.any()) and not bool(dropped.all()):
            self.points.keep(~dropped)

    def _dropped(self, unit: float, share: float) -> Tensor:
        """[N] bool: too faint, or absurdly large for where they are. At first they may be faint: 5.1's threshold holds from half time.

        In the end size does not matter: nothing could fill the hole that a plain wall would have.
        """
        faint = CULL_OPACITY * min(1.0, max(0.1, 2 * share))
        with torch.no_grad():
            dropped = self.points.opacities < faint
            if share < 1:
                dropped |= too_large(self.points.scales, self.distances, unit)
        return dropped
