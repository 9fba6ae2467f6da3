"""4DGS-like baseline: Gaussians in space and time, trained over a group of frames, of which every frame shows a slice."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from baselines.frame_methods import group_ranges, write_groups
from baselines.frame_training import image_gradients
from baselines.part_by_part import Frames
from baselines.shared_start import SharedStart
from splatreel.kernels import adam, splat
from splatreel.method.deform.knot_adam import Adam
from splatreel.method.train.density import (
    CULL_OPACITY,
    GROWTH_GRADIENT,
    SPLIT_FROM,
    GradientMeter,
    select_growth,
    too_large,
)
from splatreel.method.train.losses import GROWTH
from splatreel.method.train.render import View, relative_distances
from splatreel.method.train.trainable_points import (
    NAMES,
    TrainablePoints,
    children,
    default_rates,
    sigmoid,
    to_gaussians,
)
from splatreel.method.train.training_images import TrainingImages
from splatreel.scene.gaussians import Gaussians

RATES = {"centers": 0.02, "log_durations": 0.01, "velocities": 1e-3}
"""Learning rates. Centers are in group lengths, velocities in viewing distances per group."""
HIDDEN = 0.05
"""Temporal weight below which a point is not drawn, as in 4DGS."""
OPACITIES = 1e-7, 1 - 1e-7
"""Range of the opacity of a slice, so that its logit is finite."""
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

    def __init__(self, points: Gaussians, unit: float, rates: dict[str, float]) -> None:
        """Create points that rest and are visible during the whole group.

        Args:
            points: N points.
            unit: Typical viewing distance, world units.
            rates: Learning rates of the attributes in space.
        """
        self.space = TrainablePoints.from_gaussians(points, rates)
        self.unit = unit
        count = len(points)
        start = {"centers": np.full((count, 1), 0.5), "log_durations": np.zeros((count, 1))}
        start["velocities"] = np.zeros((count, 3))
        self.time = {name: Adam(value, RATES[name], eps=1e-15) for name, value in start.items()}

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.space)

    def slice(self, moment: float) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Return the unconstrained arrays of the points that are visible at a moment, 0..1, and their rows [M]."""
        away, weights = self._fading(moment)
        rows = np.flatnonzero(weights > HIDDEN)
        params = self.space.rows(rows)
        params["means"] = params["means"] + self.unit * self._time("velocities")[rows] * away[rows]
        opacities = np.clip(sigmoid(params["logit_opacities"]) * weights[rows], *OPACITIES)
        params["logit_opacities"] = np.log(opacities / (1 - opacities))
        return params, rows

    def gradients(
        self, moment: float, rows: np.ndarray, d_slice: Mapping[str, np.ndarray]
    ) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        """Return the gradients to all attributes in space and in time, by name, given those to the arrays of a slice.

        Args:
            moment: Moment of the slice, 0..1.
            rows: [M] rows of its points.
            d_slice: Gradients to the M points by name.
        """
        away, weights = self._fading(moment)
        away, d_means = away[rows], d_slice["means"]
        opaque = sigmoid(self.space.adams["logit_opacities"].parameter[rows])
        shown = opaque * weights[rows]
        # The gradient to the logarithm of the opacity: d logit(o) / d log(o) = 1 / (1 - o). Clipped opacities have none.
        inside = (shown >= OPACITIES[0]) & (shown <= OPACITIES[1])
        d_log = d_slice["logit_opacities"] * inside / (1 - np.clip(shown, *OPACITIES))
        nearing = away * np.exp(-2 * self._time("log_durations")[rows])  # d log(weight) / d center
        space = dict(d_slice) | {"logit_opacities": d_log * (1 - opaque)}
        pull = (d_means * self._time("velocities")[rows]).sum(1, keepdims=True)
        time = {
            "centers": d_log[:, None] * nearing - self.unit * pull,
            "log_durations": d_log[:, None] * nearing * away,
            "velocities": self.unit * away * d_means,
        }
        return self._of_all(space, rows), self._of_all(time, rows)

    def at(self, moment: float) -> Gaussians:
        """Return all points at a moment, 0..1. Hidden ones are transparent, and wait where they were or will be visible."""
        away, weights = self._fading(moment)
        reach = math.sqrt(-2 * math.log(HIDDEN)) * np.exp(self._time("log_durations"))
        plain = to_gaussians(self.space.params)
        means = plain.means + self.unit * self._time("velocities") * np.clip(away, -reach, reach)
        return replace(
            plain, means=means, opacities=np.where(weights > HIDDEN, plain.opacities * weights, np.float32(0))
        )

    def step(self, space: dict[str, np.ndarray], time: dict[str, np.ndarray], share: float) -> None:
        """Follow the gradients to all attributes in space and in time. share: share of training that is over, 0..1."""
        decay = 0.1**share
        self.space.scale_rates({"means": decay})
        self.time["velocities"].rate = RATES["velocities"] * decay
        steps = self.space.follow([space[name] for name in NAMES])
        adam.adam([*steps, *(one.follow(time[name]) for name, one in self.time.items())])

    def keep(self, kept: np.ndarray) -> None:
        """Keep the points of a mask."""
        self.space.keep(kept)
        for one in self.time.values():
            one.rewrite(lambda rows: rows[kept], lambda rows: rows[kept])

    def split(self, chosen: np.ndarray, rng: np.random.Generator) -> None:
        """Replace points by two children each, sampled from the parent in time, and if it is large in space too.

        Children live 1.6 times shorter, and large ones are 1.6 times smaller.
        """
        if not chosen.any():
            return
        large = self.space.scales.max(1)[chosen] > SPLIT_FROM * self.unit
        twice = np.concatenate([large, large])
        born = children(self.space, chosen, rng)
        for name, value in self.space.rows(chosen).items():
            born[name][~twice] = np.concatenate([value, value])[~twice]
        times = {name: np.concatenate([self._time(name)[chosen]] * 2) for name in self.time}
        moved = rng.standard_normal(times["centers"].shape, np.float32) * np.exp(times["log_durations"])
        times["centers"] = times["centers"] + moved
        born["means"] = born["means"] + self.unit * times["velocities"] * moved
        times["log_durations"] = times["log_durations"] - math.log(1.6)
        self.keep(~chosen)
        self.space.append(born)
        for name, one in self.time.items():
            one.rewrite(
                lambda rows, new=times[name]: np.concatenate([rows, new]),
                lambda rows, new=times[name]: np.concatenate([rows, np.zeros_like(new)]),
            )

    def check(self) -> None:
        """Raise `GaussiansError` if a value is NaN or infinite."""
        self.space.check()
        splat.check_finite(**{name: one.parameter for name, one in self.time.items()})

    def _time(self, name: str) -> np.ndarray:
        return self.time[name].parameter

    def _fading(self, moment: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the time since each point's center [N, 1], and its temporal weight [N]."""
        away = moment - self._time("centers")
        return away, np.exp(-0.5 * np.square(away * np.exp(-self._time("log_durations"))))[:, 0]

    def _of_all(self, gradients: dict[str, np.ndarray], rows: np.ndarray) -> dict[str, np.ndarray]:
        """Return gradients of some rows as gradients of all, which are 0 elsewhere."""
        found = {name: np.zeros((len(self), *value.shape[1:]), np.float32) for name, value in gradients.items()}
        for name, value in gradients.items():
            found[name][rows] = value
        return found


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
    points = SpaceTimePoints(before, unit, default_rates(unit, config.keyframe.rate_scale))
    rng, splits = np.random.default_rng(seed), np.random.default_rng([seed, 1])
    moments, every = _moments(len(images)), max(int(GROWTH * iterations) // DENSIFICATIONS, 20)
    meter, begin, order = GradientMeter(len(points)), 0, list[int]()
    cameras = len(images[0].views)
    for sized in zip(*[p.sizes(iterations, 0.0, config.training_megapixels) for p in images], strict=True):
        end, shown = sized[0][0], [frame for _, frame in sized]
        for iteration in range(begin, end):
            order = order or rng.permutation(len(shown) * cameras).tolist()
            frame, camera = divmod(order.pop(), cameras)
            found = _learn(points, shown[frame], camera, moments[frame], gains[camera], meter)
            points.step(*found, iteration / iterations)
            done = iteration + 1
            if done % every == 0 and done <= GROWTH * iterations:
                _densify(points, meter, shown[frame].views, ROOM * start.max_points, splits)
                meter = GradientMeter(len(points))
        begin = max(begin, end)
    points.check()
    return points


def _learn(
    points: SpaceTimePoints, images: TrainingImages, camera: int, moment: float, gain: np.ndarray, meter: GradientMeter
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Compare one image of one camera. Return the gradients to all attributes in space and in time."""
    params, rows = points.slice(moment)
    found = image_gradients(params, None, images, camera, gain)
    meter.add(found.screen, images.views[camera].width, images.views[camera].height, rows)
    return points.gradients(moment, rows, found.points)


def _densify(
    points: SpaceTimePoints, meter: GradientMeter, views: list[View], most: int, rng: np.random.Generator
) -> None:
    """Prune faint and large points, and split those with large gradients."""
    space = points.space
    distances = relative_distances(space.means, views, points.unit, 1.0)
    kept = (space.opacities >= CULL_OPACITY) & ~too_large(space.scales, distances, points.unit)
    grow = select_growth(meter, GROWTH_GRADIENT, most - int(kept.sum())) & kept
    points.keep(kept)
    points.split(grow[kept], rng)


def _moments(count: int) -> list[float]:
    """Return the moments of a group's frames, 0..1."""
    return [frame / max(count - 1, 1) for frame in range(count)]
