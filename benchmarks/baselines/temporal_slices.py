"""4DGS-like baseline: Gaussians in space and time, trained over a group of frames, of which every frame shows a slice."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from baselines.frame_methods import group_ranges, write_groups
from baselines.part_by_part import Frames
from baselines.shared_start import SharedStart
from splatreel.kernels import splat
from splatreel.method.deform.knot_adam import Adam, step
from splatreel.method.train.density import (
    CULL_OPACITY,
    GROWTH_GRADIENT,
    SPLIT_FROM,
    GradientMeter,
    children,
    select_growth,
    too_large,
)
from splatreel.method.train.keyframe_trainer import LAMBDA_DSSIM
from splatreel.method.train.losses import GROWTH
from splatreel.method.train.render import View, activate, draw, relative_distances, splats
from splatreel.method.train.trainable_points import TrainablePoints, default_rates
from splatreel.method.train.training_images import TrainingImages
from splatreel.scene.gaussians import Gaussians

RATES = {"centers": 0.02, "log_durations": 0.01, "velocities": 1e-3}
"""Learning rates. Centers are in group lengths, velocities in viewing distances per group."""
HIDDEN = 0.05
"""Temporal weight below which a point is not drawn, as in 4DGS."""
DENSIFICATIONS = 20
"""Densifications of a group, all in the share of training that `GROWTH` names."""
ROOM = 2
"""Maximum number of points of a group, in maximum numbers of a frame's. Points that live briefly do not share a frame."""


class SpaceTimePoints:
    """Gaussians that move at constant velocity and fade in and out.

    A point at time t has the opacity o exp(-(t - center)^2 / (2 duration^2)) and the position mean + velocity (t - center).
    Times run from 0 to 1 over the group.

    Source:
        Yang et al. 2024, "Real-time Photorealistic Dynamic Scene Representation and Rendering with 4D Gaussian Splatting",
        section 3.2: slices of 4D Gaussians. There, one 4D rotation gives velocity and shape.
    """

    def __init__(self, points: Gaussians, unit: float, rates: dict[str, float], device: torch.device) -> None:
        """Create points that rest and are visible during the whole group.

        Args:
            points: N points.
            unit: Typical viewing distance, world units.
            rates: Learning rates of the attributes in space.
            device: Device that trains.
        """
        self.space = TrainablePoints.from_gaussians(points, rates, device)
        self.unit = unit
        count = len(points)
        start = {"centers": torch.full((count, 1), 0.5), "log_durations": torch.zeros(count, 1)}
        start["velocities"] = torch.zeros(count, 3)
        self.time = {name: Adam(value.to(device), RATES[name], eps=1e-15) for name, value in start.items()}

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.space)

    def slice(self, moment: float) -> tuple[dict[str, Tensor], Tensor]:
        """Return the unconstrained tensors of the points that are visible at a moment, 0..1, and their rows [M]."""
        away, weights = self._fading(moment)
        rows = torch.nonzero(weights.detach() > HIDDEN)[:, 0]
        params = {name: value[rows] for name, value in self.space.params.items()}
        params["means"] = params["means"] + self.unit * self.time["velocities"].tensor[rows] * away[rows]
        opacities = (params["logit_opacities"].sigmoid() * weights[rows]).clamp(1e-7, 1 - 1e-7)
        params["logit_opacities"] = opacities.logit()
        return params, rows

    @torch.no_grad()
    def at(self, moment: float) -> Gaussians:
        """Return all points at a moment, 0..1. Hidden ones are transparent, and wait where they were or will be visible."""
        away, weights = self._fading(moment)
        reach = math.sqrt(-2 * math.log(HIDDEN)) * self.time["log_durations"].tensor.exp()
        means, quats, scales, opacities, sh = activate(self.space.params)
        means = means + self.unit * self.time["velocities"].tensor * away.clamp(-reach, reach)
        opacities = torch.where(weights > HIDDEN, opacities * weights, 0.0)
        quats = torch.nn.functional.normalize(quats, dim=-1)
        return Gaussians(*(t.cpu().numpy() for t in (means, quats, scales, opacities, torch.cat(sh, 1))))

    def _fading(self, moment: float) -> tuple[Tensor, Tensor]:
        """Return the time since each point's center [N, 1], and its temporal weight [N]."""
        away = moment - self.time["centers"].tensor
        return away, (-0.5 * (away * (-self.time["log_durations"].tensor).exp()) ** 2).exp()[:, 0]

    def step(self, share: float) -> None:
        """Follow the gradients and clear them. share: share of training that is over, 0..1."""
        decay = 0.1**share
        self.space.scale_rates({"means": decay})
        self.time["velocities"].rate = RATES["velocities"] * decay
        self.space.step()
        step(self.time.values())

    def keep(self, kept: Tensor) -> None:
        """Keep the points of a mask."""
        self.space.keep(kept)
        for adam in self.time.values():
            adam.rewrite(lambda rows: rows[kept], lambda rows: rows[kept])

    def split(self, chosen: Tensor, generator: torch.Generator) -> None:
        """Replace points by two children each, sampled from the parent in time, and if it is large in space too.

        Children live 1.6 times shorter, and large ones are 1.6 times smaller.
        """
        if not bool(chosen.any()):
            return
        large = self.space.scales.detach().amax(1)[chosen] > SPLIT_FROM * self.unit
        twice = torch.cat([large, large])
        smaller = children(self.space, chosen, generator)
        same = {name: torch.cat([value, value]) for name, value in self.space.rows(chosen).items()}
        born = {
            name: torch.where(twice.view(-1, *[1] * (value.ndim - 1)), value, same[name])
            for name, value in smaller.items()
        }
        times = {name: torch.cat([adam.tensor.detach()[chosen]] * 2) for name, adam in self.time.items()}
        spread = torch.randn(times["centers"].shape, generator=generator).to(twice.device)
        moved = spread * times["log_durations"].exp()
        times["centers"] = times["centers"] + moved
        born["means"] = born["means"] + self.unit * times["velocities"] * moved
        times["log_durations"] = times["log_durations"] - math.log(1.6)
        self.keep(~chosen)
        self.space.append(born)
        for name, adam in self.time.items():
            adam.rewrite(
                lambda rows, new=times[name]: torch.cat([rows, new]),
                lambda rows, new=times[name]: torch.cat([rows, torch.zeros_like(new)]),
            )


class TemporalSlices:
    """4DGS-like: Gaussians in space and time.

    What it is: points that live for a while and move at constant velocity, as the slices of 4D Gaussians do. They train on
    all frames of a group in random order, with density control in space and time, from the points of the frame before.

    What it is not: 4DGS's rotation in four dimensions, which also changes the shape over time, and its spherindrical harmonics,
    which change the color. 4DGS has no groups. Our codec stores the offset and opacity of every point in every frame, with
    knowledge of the group, which suits these points less than others.
    """

    def first(self, keyframe: Gaussians) -> Gaussians:
        """Return the keyframe."""
        return keyframe

    def parts(self, start: SharedStart) -> list[range]:
        """Return the frames of each group."""
        return group_ranges(start)

    def train(
        self, start: SharedStart, before: Gaussians, images: Sequence[TrainingImages], iterations: int, first: int
    ) -> list[Gaussians]:
        """Train the points of a group and return them at each frame."""
        alive = before[before.opacities >= CULL_OPACITY]
        points = train_slices(start, alive, images, iterations, first)
        return [points.at(moment) for moment in _moments(len(images))]

    def write(self, start: SharedStart, frames: Frames, reel: Path) -> None:
        """Write groups of all points without layers."""
        write_groups(start, frames, reel, self.parts(start), start.config.encode)


def train_slices(
    start: SharedStart, before: Gaussians, images: Sequence[TrainingImages], iterations: int, first: int
) -> SpaceTimePoints:
    """Train points over a group of frames.

    Args:
        start: Run that the baseline starts from.
        before: Points of the frame before.
        images: Training images of each frame.
        iterations: Iterations of training.
        first: First frame, which the seed depends on.
    """
    config, seed = start.config, start.config.seed + first
    unit, gains = start.layout.unit, start.gains().values
    points = SpaceTimePoints(before, unit, default_rates(unit, config.keyframe.rate_scale), start.device)
    rng, generator = np.random.default_rng(seed), torch.Generator().manual_seed(seed)
    moments, every = _moments(len(images)), max(int(GROWTH * iterations) // DENSIFICATIONS, 20)
    meter, begin, order = GradientMeter(len(points), start.device), 0, list[int]()
    cameras = len(images[0].views)
    for sized in zip(*[p.sizes(iterations, 0.0, config.training_megapixels) for p in images], strict=True):
        end, shown = sized[0][0], [frame for _, frame in sized]
        for iteration in range(begin, end):
            order = order or rng.permutation(len(shown) * cameras).tolist()
            frame, camera = divmod(order.pop(), cameras)
            _learn(points, shown[frame], camera, moments[frame], gains[camera], meter)
            points.step(iteration / iterations)
            done = iteration + 1
            if done % every == 0 and done <= GROWTH * iterations:
                _densify(points, meter, shown[frame].views, ROOM * start.max_points, generator)
                meter = GradientMeter(len(points), start.device)
        begin = max(begin, end)
    splat.check_finite(**points.space.params, **{name: adam.tensor for name, adam in points.time.items()})
    return points


def _learn(
    points: SpaceTimePoints, images: TrainingImages, camera: int, moment: float, gain: Tensor, meter: GradientMeter
) -> None:
    """Compare one image of one camera, and collect the gradients."""
    view: View = images.views[camera]
    params, rows = points.slice(moment)
    drawing = draw(splats(*activate(params), view, images.near), view)
    drawing.loss(images.target(0, camera, drawing.image, gain), LAMBDA_DSSIM, gain).backward()
    grad = drawing.means2d.grad
    assert grad is not None
    meter.add(grad, view.width, view.height, rows)


def _densify(
    points: SpaceTimePoints, meter: GradientMeter, views: list[View], most: int, generator: torch.Generator
) -> None:
    """Prune faint and large points, and split those with large gradients."""
    space = points.space
    distances = relative_distances(space.means, views, points.unit, 1.0)
    kept = (space.opacities.detach() >= CULL_OPACITY) & ~too_large(space.scales.detach(), distances, points.unit)
    grow = select_growth(meter, GROWTH_GRADIENT, most - int(kept.sum())) & kept
    points.keep(kept)
    points.split(grow[kept], generator)


def _moments(count: int) -> list[float]:
    """Return the moments of a group's frames, 0..1."""
    return [frame / max(count - 1, 1) for frame in range(count)]
