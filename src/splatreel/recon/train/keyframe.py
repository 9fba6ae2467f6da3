"""Static reconstruction of a keyframe: 3DGS, from sparse points or from the previous group (paper section 5.1)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from splatreel.config import KeyframeConfig
from splatreel.kernels import splat
from splatreel.progress import Progress
from splatreel.recon.cameras.color_gains import CameraGains
from splatreel.recon.train.average import Average
from splatreel.recon.train.density import (
    CULL_OPACITY,
    GROWTH_GRADIENT,
    GradientMeter,
    children,
    select_growth,
    too_large,
)
from splatreel.recon.train.losses import Depths, psnr, roughness, spread
from splatreel.recon.train.points import TrainablePoints, default_rates
from splatreel.recon.train.render import Splats, StaticCache, View, deformed, draw, halved, relative_distances
from splatreel.scene.gaussians import C0, Gaussians


@dataclass(frozen=True)
class Stage:
    """What a stage of training looks at: the views, their targets at one resolution, and the scene's measures.

    images: [C, H, W, 3] uint8. unit: typical viewing distance, near: near plane, both in world units.
    """

    views: list[View]
    images: Tensor
    near: float
    unit: float

    def halved(self) -> Stage:
        """The same at half size."""
        return replace(self, views=[view.halved() for view in self.views], images=halved(self.images))


def starting_points(
    positions: np.ndarray, colors: np.ndarray, config: KeyframeConfig, unit: float, device: torch.device
) -> TrainablePoints:
    """Gaussians at sparse points, as large as the distance to their neighbours (3DGS section 5.1).

    positions: [P, 3] world. colors: [P, 3] 0..1.
    """
    points = torch.from_numpy(np.asarray(positions, np.float32)).to(device)
    neighbours = min(3, len(points) - 1)
    if neighbours > 0:
        distances = splat.nearest_neighbours(points, neighbours)[1]
        size = distances.square().mean(1).sqrt().clamp(2e-3 * unit, 0.07 * unit)
    else:
        size = torch.full((len(points),), 0.02 * unit, device=device)
    count = len(points)
    quats = torch.zeros(count, 4, device=device)
    quats[:, 0] = 1
    base = (torch.from_numpy(np.asarray(colors, np.float32)).to(device) - 0.5) / C0
    params = {
        "means": points,
        "quats": quats,
        "log_scales": size.log()[:, None].repeat(1, 3),
        "logit_opacities": torch.full((count,), math.log(0.1 / 0.9), device=device),
        "sh_base": base[:, None],
        "sh_rest": torch.zeros(count, (config.sh_degree + 1) ** 2 - 1, 3, device=device),
    }
    return TrainablePoints(params, default_rates(unit, config.rate_scale))


GROWTH = 0.6
"""Share of the iterations in which points are densified; from then on opacity has its price: earlier, it hinders what is to grow.
Before a backdrop nothing has a price: what moves has few points, and needs them."""
SURFACES_FROM = 0.4
"""Share of the iterations from which on points before a surface and bends cost something: earlier, the surface is not there yet."""
SURFACES_EVERY = 2
"""Iterations between two that look at surfaces. They then count twice."""


class KeyframeTrainer:
    """Optimises points on the images of one frame, with densification in the first part of the iterations."""

    def __init__(
        self,
        points: TrainablePoints,
        gains: CameraGains,
        config: KeyframeConfig,
        *,
        backdrop: Gaussians | None = None,
        max_points: int,
        seed: int = 0,
    ) -> None:
        self.points = points
        self.gains = gains
        self.config = config
        self.static = backdrop
        self.max_points = max_points
        self.generator = torch.Generator().manual_seed(seed)
        self.rng = np.random.default_rng(seed)
        self.done = 0
        self.strides = torch.ones(len(points), 1, device=points.means.device)

    def train(self, stage: Stage, iterations: int, total: int, progress: Progress) -> None:
        """Run `iterations` of `total` on one resolution; call again with another stage to go on."""
        device = self.points.means.device
        behind = None
        if self.static is not None and len(self.static):
            behind = StaticCache(self.static, stage.views, stage.near, device)
        meter = GradientMeter(len(self.points), device)
        self._stride(stage)
        average = Average(self.config.average_share, total)
        cameras: list[int] = []
        for _ in range(iterations):
            if not cameras:
                cameras = list(self.rng.permutation(len(stage.views)))
            camera = int(cameras.pop())
            loss, grad = self._step(stage, camera, behind, self.done / total)
            self.done += 1
            share, averaged = self.done / total, average.runs(self.done)
            self._anneal(share)
            if share <= GROWTH:
                meter.add(grad[: len(self.points)], stage.views[camera].width, stage.views[camera].height)
                if self.done % self.config.densify_every == 0 and self.done >= 2 * self.config.densify_every:
                    self._densify(meter, stage.unit, share)
                    meter = GradientMeter(len(self.points), device)
                    self._stride(stage)
            elif self.done % 500 == 0 and not averaged:
                self._prune(stage.unit, share)
                self._stride(stage)
            if averaged:
                average.add(self.done, self.points.params.values())
            if self.done % 25 == 0:
                self.points.check()
                progress.update(self.done, loss=float(loss), points=len(self.points))
        average.settle(self.points.params.values())
        self._prune(stage.unit, self.done / total)

    @torch.no_grad()
    def psnr(self, stage: Stage) -> float:
        """Mean PSNR over a stage's images, without a backdrop."""
        values = []
        for view, image, gain in zip(stage.views, stage.images, self.gains.values, strict=True):
            shown = draw(deformed(self.points.params, None, None, view, stage.near), view).image
            values.append(psnr(shown * gain, image))
        return float(np.mean(values))

    def _stride(self, stage: Stage) -> None:
        self.strides = relative_distances(self.points.means, stage.views, stage.unit, self.config.far_step_scale)[
            :, None
        ]

    def _step(self, stage: Stage, camera: int, behind: StaticCache | None, share: float) -> tuple[Tensor, Tensor]:
        """share: of training that is over. Returns the loss and the gradient of the places on the image."""
        p, view = self.points, stage.views[camera]
        moving = deformed(p.params, None, None, view, stage.near)
        drawing = draw(moving, view, behind.view(camera) if behind else None)
        loss = splat.photometric_loss(drawing.image, stage.images[camera], gain=self.gains.of(camera))
        cost = self._price(moving, camera, stage, share) if behind is None else 0.0
        (loss + cost).backward()
        grad = drawing.means2d.grad
        assert grad is not None
        p.step(self.strides)
        self.gains.step()
        return loss.detach(), grad

    def _price(self, points: Splats, camera: int, stage: Stage, share: float) -> Tensor | float:
        """What opacities cost, per pixel, points before a surface, and surfaces that bend."""
        config, view, cost = self.config, stage.views[camera], 0.0
        if config.lambda_opacity and share > GROWTH:
            cost = config.lambda_opacity * self.points.opacities.sum() / (view.width * view.height)
        priced = config.lambda_spread or config.lambda_roughness
        if priced and share > SURFACES_FROM and self.done % SURFACES_EVERY == 0:
            depths = Depths.of(points, view, stage.near)
            rough = roughness(depths, stage.images[camera], stage.unit / stage.near)
            cost = cost + SURFACES_EVERY * (config.lambda_spread * spread(depths) + config.lambda_roughness * rough)
        return cost

    def _anneal(self, share: float) -> None:
        late = 0.3 if share > 0.8 else 1.0
        factors = {"means": 0.02**share, "quats": 1.0, "log_scales": 0.2 if share > 0.8 else 1.0}
        self.points.scale_rates(factors, default=late)

    def _densify(self, meter: GradientMeter, unit: float, share: float) -> None:
        points = self.points
        room = self.max_points - len(points)
        grow = select_growth(meter, GROWTH_GRADIENT, room)
        doomed = self._doomed(unit, share)
        large = points.scales.detach().amax(1) > 0.01 * unit
        split, clone = grow & large & ~doomed, grow & ~large & ~doomed
        newborn = points.rows(clone)
        halves = children(points, split, self.generator)
        points.keep(~(doomed | split))
        points.append({name: torch.cat([newborn[name], halves[name]]) for name in newborn})

    def _doomed(self, unit: float, share: float) -> Tensor:
        """Points too faint, or absurdly large for where they are. Young ones may be faint: the threshold of 5.1 holds from half time.

        In the end size does not matter: nothing could fill the hole that a plain wall would have.
        """
        faint = CULL_OPACITY * min(1.0, max(0.1, 2 * share))
        with torch.no_grad():
            doomed = self.points.opacities < faint
            if share < 1:
                doomed |= too_large(self.points.scales, self.strides[:, 0], unit)
        return doomed

    def _prune(self, unit: float, share: float) -> None:
        doomed = self._doomed(unit, share)
        if bool(doomed.any()) and not bool(doomed.all()):
            self.points.keep(~doomed)
