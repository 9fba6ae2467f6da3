"""Density control of keyframes and groups: densification (3DGS), conversion of static points (paper section 4.1) and pruning."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from splatreel.config import Config, KeyframeConfig
from splatreel.config.config import PAPER_WIDTH
from splatreel.kernels import splat
from splatreel.method.layering.lift import NEIGHBORS
from splatreel.method.train.dynamic_points import DynamicPoints
from splatreel.method.train.losses import GROWTH
from splatreel.method.train.render import StaticCache, contributions, relative_distances
from splatreel.method.train.trainable_points import TrainablePoints, children, halves, sigmoid
from splatreel.method.train.training_images import TrainingImages
from splatreel.scene.volumes import Volume

CULL_OPACITY = 0.05
"""Opacity below which points are pruned (paper section 5.1). Fainter points hardly show, and cost bytes and time."""
GROWTH_GRADIENT = 2e-4
"""Mean screen-space gradient above which points are densified, in normalized device units; the value of 3DGS."""
ABSOLUTE_GRADIENT = 4e-4
"""Threshold of the absolute gradient, where it is measured, for images up to `FINE_WIDTH`. Gradients of a large splat over fine
detail cancel each other in the signed sum, but not in this one (AbsGS)."""
ADAPT_GRADIENT = 3e-4
"""Mean gradient above which static points become dynamic (lambda_adp^grad), in normalized device units at a width of `PAPER_WIDTH`.
Splats of smaller images are larger and have larger gradients."""
ADAPT_NEIGHBORS = 0.6
"""Share of dynamic neighbors above which static points become dynamic (lambda_adp^nn)."""
FINE_WIDTH = 320
"""Width, pixels, above which images show more detail, and the threshold of the absolute gradient falls with its square root."""
LARGEST_SCALE = 0.5
"""Largest scale of a point, in typical viewing distances, multiplied by `relative_distances`."""


class GradientMeter:
    """Mean length of every point's screen-space positional gradient over the views that see it, in normalized device units."""

    def __init__(self, count: int) -> None:
        """Start with no views of `count` points."""
        self.sum, self.seen = np.zeros((2, count), np.float32)

    def add(self, grad: np.ndarray, width: int, height: int, index: np.ndarray | None = None) -> None:
        """Add the gradients of one view.

        Args:
            grad: [M, 2] dL/d(pixels).
            width: Image width, pixels.
            height: Image height, pixels.
            index: [M] different points that the rows of `grad` belong to; None means all points.
        """
        length = np.hypot(grad[:, 0] * (width / 2), grad[:, 1] * (height / 2))
        rows = slice(None) if index is None else index
        self.sum[rows] += length
        self.seen[rows] += length > 0

    def mean(self) -> np.ndarray:
        """Return the mean [N]."""
        return self.sum / np.maximum(self.seen, 1)


def select_growth(meter: GradientMeter, threshold: float, budget: int) -> np.ndarray:
    """Return the mask of the points to densify: at most `budget` points, with the largest gradients above the threshold."""
    gradient = meter.mean()
    grow = gradient > threshold
    if int(grow.sum()) > budget:
        if budget <= 0:
            return np.zeros_like(grow)
        grow &= gradient >= np.partition(gradient, -budget)[-budget]
    return grow


def too_large(scales: np.ndarray, distances: np.ndarray, unit: float) -> np.ndarray:
    """Return the mask [N] of points that are too large for their distance.

    Args:
        scales: [N, 3] standard deviations, world units.
        distances: [N], see `relative_distances`.
        unit: Typical viewing distance, world units.
    """
    return scales.max(1) > LARGEST_SCALE * unit * distances


PRUNE_EVERY = 500
"""Iterations between two prunings once no points are added."""

SPLIT_FROM = 0.01
"""Scale above which a point is split instead of cloned, in typical viewing distances."""


class KeyframeDensity:
    """Density control of a keyframe. It changes the rows of `points`.

    Attributes:
        distances: [N], see `relative_distances`; ones before `restart` was called.
    """

    def __init__(
        self, points: TrainablePoints, config: KeyframeConfig, max_points: int, seed: int, region: Volume | None = None
    ) -> None:
        """Create the density control of a keyframe.

        Args:
            points: Points whose rows are changed.
            config: Keyframe settings.
            max_points: Maximum number of points.
            seed: Seed of the positions of split points.
            region: Volume in which points are densified; None is everywhere.
        """
        self.points = points
        self.config = config
        self.max_points = max_points
        self.region = region
        self.hull: Volume | None = None
        """Volume outside of which points are removed; None is everywhere."""
        self.rng = np.random.default_rng(seed)
        self.distances = np.ones(len(points), np.float32)

    def restart(self, images: TrainingImages) -> None:
        """Restart the measurements, after points were added or removed or the images changed."""
        self.meter = GradientMeter(len(self.points))
        self.distances = relative_distances(self.points.means, images.views, images.unit, self.config.far_step_scale)

    def is_due(self, done: int, share: float, averaged: bool) -> bool:
        """Return whether `update` adds or prunes points, see there."""
        every = self.config.densify_every
        if share <= GROWTH:
            return done % every == 0 and done >= 2 * every
        return done % PRUNE_EVERY == 0 and not averaged

    def update(self, done: int, share: float, images: TrainingImages, averaged: bool, absolute: bool) -> None:
        """Add and prune points after an iteration, if due.

        Args:
            done: Number of finished iterations.
            share: Share of training that is over, 0..1.
            images: Training images.
            averaged: Values are being averaged; no point is removed any more.
            absolute: The measured gradients are absolute ones.
        """
        if not self.is_due(done, share, averaged):
            return
        if share <= GROWTH:
            self.densify(images, share, absolute)
        else:
            self.prune(images.unit, share)
        self.restart(images)

    def densify(self, images: TrainingImages, share: float, absolute: bool) -> None:
        """Clone small points with large gradients, split large ones, and prune. See `update` for the arguments."""
        unit, width = images.unit, images.views[0].width
        threshold = ABSOLUTE_GRADIENT * min(1.0, (FINE_WIDTH / width) ** 0.5) if absolute else GROWTH_GRADIENT
        points = self.points
        points.check()
        if self.region is not None:
            self.meter.sum *= self.region.contains(points.means)
        grow = select_growth(self.meter, threshold, self.room)
        dropped = self._dropped(unit, share)
        large = points.scales.max(1) > SPLIT_FROM * unit
        split, clone = grow & large & ~dropped, grow & ~large & ~dropped
        parts = halves(points, split) if absolute else children(points, split, self.rng)
        clones = points.rows(clone)
        points.keep(~(dropped | split))
        points.append({name: np.concatenate([clones[name], parts[name]]) for name in clones})

    @property
    def room(self) -> int:
        """Number of points that may still be added."""
        return self.max_points - len(self.points)

    def add(self, params: Mapping[str, np.ndarray], images: TrainingImages) -> None:
        """Add points, without those outside of the region. params: unconstrained arrays, as in `TrainablePoints`."""
        if self.region is not None:
            kept = self.region.contains(params["means"])
            params = {name: value[kept] for name, value in params.items()}
        self.points.append(params)
        self.restart(images)

    def prune(self, unit: float, share: float) -> None:
        """Prune points, but never all of them."""
        self.points.check()
        dropped = self._dropped(unit, share)
        if dropped.any() and not dropped.all():
            self.points.keep(~dropped)

    def _dropped(self, unit: float, share: float) -> np.ndarray:
        """Return [N] bool, the points that are too faint, too large for their distance, or outside of the hull.

        The threshold of opacity rises until half of training. At the end size does not matter, since no point could fill the
        hole in a plain wall.
        """
        faint = CULL_OPACITY * min(1.0, max(0.1, 2 * share))
        dropped = self.points.opacities < faint
        if share < 1:
            dropped |= too_large(self.points.scales, self.distances, unit)
        if self.hull is not None:
            within = self.hull.contains(self.points.means)
            dropped |= ~within if within.any() else False
        return dropped


CONVERT_FROM, CONVERT_TO = 0.25, 0.8
"""Range of training, as shares, in which points are converted and cloned. Earlier all moving points have large gradients;
later a new point could not be trained."""

LEAST_BUDGET = 2000
"""Minimum number of points that a group may gain. The budget is half of the initial points if that is more."""

FAINT_AT = (0.4, 0.7)
"""Shares of training at which the faintest points are pruned. By then misplaced points have faded, and the remaining ones can
fill in."""

FAINT_IMAGES = 60
"""Number of drawings by which faint points are found."""

MEASURE_EVERY = 8
"""Iterations between two measurements of the gradients of static points, which must be drawn for it."""


class GroupDensity:
    """Density control of a group. It changes the rows of `points` and the living points of `static`.

    Attributes:
        convertible: [S] bool, static points that may become dynamic.
        budget: Number of points that may still be added.
        rng: Source of the cameras by which faint points are found.
    """

    def __init__(
        self,
        points: DynamicPoints,
        static: StaticCache,
        convertible: np.ndarray,
        config: Config,
        iterations: int,
        rng: np.random.Generator,
        region: Volume | None = None,
    ) -> None:
        """Create the density control of a group.

        Args:
            points: Points whose rows are changed.
            static: Static points, of which some may be converted.
            convertible: [S] bool, static points that may become dynamic.
            config: Settings.
            iterations: Iterations of training.
            rng: Source of the cameras by which faint points are found.
            region: Volume in which points are cloned; None is everywhere.
        """
        self.region = region
        self.points = points
        self.static = static
        self.convertible = convertible
        self.config = config
        self.rng = rng
        self.every = config.layering.adapt_every
        self.iterations = iterations
        self.faint_at = {round(share * iterations) for share in FAINT_AT} if config.group.faint_share else set()
        self.budget = max(LEAST_BUDGET, len(points) // 2)
        self.restart()

    def restart(self) -> None:
        """Restart the measurements, after points were added or removed."""
        self.moving_meter = GradientMeter(len(self.points))
        self.static_meter = GradientMeter(len(self.static))

    def measured_static(self, iteration: int) -> np.ndarray | None:
        """Return [S] bool, the static points whose gradients an iteration measures; None if it draws moving tiles only."""
        due = self.measures(iteration) and iteration % MEASURE_EVERY == 0
        return self.convertible & self.static.alive if due else None

    def update(self, done: int, images: TrainingImages) -> bool:
        """Add and prune points after `done` iterations, if due. Return whether anything was due."""
        due, faint_due = self._is_regular(done), done in self.faint_at
        if due or faint_due:
            self.points.check()
        if due and self._converts(done):
            self.convert_and_clone(images)
        if due:
            self.prune(images)
        if faint_due:
            self.drop_faint(images)
        if due or faint_due:
            self.restart()
        return due or faint_due

    def is_due(self, done: int) -> bool:
        """Return whether `update` adds or prunes points after `done` iterations."""
        return self._is_regular(done) or done in self.faint_at

    def convert_and_clone(self, images: TrainingImages) -> None:
        """Convert static points (paper section 4.1), then clone dynamic points with large gradients (4.2)."""
        alive = self.static.alive
        threshold = ADAPT_GRADIENT * (PAPER_WIDTH / images.views[0].width)
        pull_static, pull_moving = self.static_meter.mean(), self.moving_meter.mean()
        convert = alive & (pull_static > threshold) | alive & self._surrounded(alive)
        converted = self._within_budget(convert & self.convertible, pull_static)
        growing = pull_moving > threshold
        if self.region is not None:
            growing &= self.region.contains(self.points.means)
        clones = self._within_budget(growing, pull_moving)
        self.points.clone(clones)
        self.convert(converted)

    def convert(self, index: np.ndarray) -> None:
        """Make static points [M] int64 dynamic."""
        if len(index) == 0:
            return
        rows = {name: value[index] for name, value in self.static.params.items()}
        alive = self.static.alive.copy()
        alive[index] = False
        self.static.set_alive(alive)
        self.points.append(rows)

    def prune(self, images: TrainingImages) -> None:
        """Drop points that hardly show and points that are too large for their distance."""
        config, points = self.config.keyframe, self.points
        keep = sigmoid(points.highest_logits()) >= CULL_OPACITY
        distances = relative_distances(points.means, images.views, images.unit, config.far_step_scale)
        keep &= ~too_large(points.canonical.scales, distances, images.unit)
        if not keep.all():
            points.keep(np.flatnonzero(keep))

    def drop_faint(self, images: TrainingImages) -> None:
        """Drop the points that together fill a small share of the images (`GroupConfig.faint_share`): often half of all points."""
        total = np.zeros(len(self.points), np.float32)
        for k in range(FAINT_IMAGES):
            frame = k * (images.count - 1) // (FAINT_IMAGES - 1)
            camera = int(self.rng.integers(len(images.views)))
            view = images.views[camera]
            splats = self.points.at(frame, view, images.near)
            total += contributions(splats, view, self.static.view(camera))
        order = total.argsort(kind="stable")
        held = total[order].cumsum() / max(total.sum(), np.float32(1e-9))
        self.points.keep(np.sort(order[held >= self.config.group.faint_share]))

    def _is_regular(self, done: int) -> bool:
        return self.every > 0 and done % self.every == 0

    def _converts(self, done: int) -> bool:
        return CONVERT_FROM <= done / self.iterations <= CONVERT_TO

    def measures(self, iteration: int) -> bool:
        """Return whether points are converted at the end of this interval."""
        return self.every > 0 and self._converts((iteration // self.every + 1) * self.every)

    def _within_budget(self, chosen: np.ndarray, pull: np.ndarray) -> np.ndarray:
        """Return up to `budget` points [M] int64 of a mask, those with the largest gradients, and reduce the budget."""
        index = np.flatnonzero(chosen)
        if len(index) > self.budget:
            index = index[np.argsort(-pull[index], kind="stable")[: self.budget]]
        self.budget -= len(index)
        return index

    def _surrounded(self, alive: np.ndarray) -> np.ndarray:
        """Return [S] bool, the static points of whose nearest neighbors more than lambda_adp^nn are dynamic."""
        index = np.flatnonzero(alive)
        everything = np.concatenate([self.static.means[index], self.points.means])
        k = min(NEIGHBORS, len(everything) - 1)
        surrounded = np.zeros_like(alive)
        if len(index) and k > 0:
            neighbors = splat.nearest_neighbors(everything, k)[0][: len(index)]
            dynamic = (neighbors >= len(index)).mean(1)
            surrounded[index] = dynamic > ADAPT_NEIGHBORS
        return surrounded
