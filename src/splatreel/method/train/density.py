"""Density control: densification (3DGS), conversion of static points (paper section 4.1) and pruning.

A first keyframe also has opacity resets, and new points where images differ most from their targets.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from splatreel.config import Config, KeyframeConfig
from splatreel.config.config import PAPER_WIDTH
from splatreel.kernels import splat
from splatreel.kernels.splat import Splats
from splatreel.method.init.planesweep import NOISE
from splatreel.method.init.triangulate import nearest_poses
from splatreel.method.layering.lift import NEIGHBORS
from splatreel.method.train.dynamic_points import DynamicPoints
from splatreel.method.train.losses import GROWTH
from splatreel.method.train.render import StaticCache, View, contributions, relative_distances
from splatreel.method.train.terms.term import Depths
from splatreel.method.train.trainable_points import TrainablePoints, children, halves, sigmoid
from splatreel.method.train.training_images import TrainingImages
from splatreel.scene.gaussians import C0
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
        self.sum, self.seen = np.zeros((2, count), np.float32)

    def add(self, grad: np.ndarray, width: int, height: int, index: np.ndarray | None = None) -> None:
        """Add the gradients [M, 2] dL/d(pixels) of one view.

        `index` [M]: different points that the rows belong to; None is all points.
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
    """Return the mask [N] of points that are too large for their distance."""
    return scales.max(1) > LARGEST_SCALE * unit * distances


PRUNE_EVERY = 500
"""Iterations between two prunings once no points are added."""

SPLIT_FROM = 0.01
"""Scale above which a point is split instead of cloned, in typical viewing distances."""


class KeyframeDensity:
    """Density control of a keyframe. It changes the rows of `points`."""

    def __init__(
        self, points: TrainablePoints, config: KeyframeConfig, max_points: int, seed: int, region: Volume | None = None
    ) -> None:
        """Create the density control. Points are densified within `region` only; None is everywhere."""
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

        `averaged`: no point is removed any more. `absolute`: the measured gradients are absolute ones.
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
        """Create the density control.

        `convertible` [S]: static points that may become dynamic. Points are cloned within `region` only.
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


RESET_AT = (0.25, 0.45)
"""Shares of training after which opacities are reset (docs/experiments/2026-11-28-pruning-and-view-scores.md)."""
RESET_OPACITY = 0.05
"""Maximum opacity after a reset."""
PRUNED_SHARE = 0.2
"""Share of all points that is pruned after each reset."""
RECOVERY = 40
"""Minimum number of iterations between a reset and the pruning."""
RECOVERY_ROUNDS = 1.5
"""Minimum number of times that each view is drawn between a reset and the pruning. A point recovers only in views that see it."""
MAX_RECOVERY = 0.1
"""Share of training above which recovery takes too long. Opacities are then never reset."""


class OpacityResets:
    """Opacity resets of a first keyframe, and the prunings of points that recover least, by numbers of finished iterations.

    A reset makes all points faint. Points that images need become opaque again within a few dozen iterations. Points behind others,
    in front of a surface or next to similar ones do not. Opacity tells them apart only after a reset.

    Source:
        Recovery-aware pruning of Improved-GS (Deng et al. 2025).
    """

    def __init__(self, total: int, views: int) -> None:
        wait = max(RECOVERY, math.ceil(RECOVERY_ROUNDS * views))
        self.resets = [round(at * total) for at in RESET_AT] if wait <= MAX_RECOVERY * total else []
        self.prunings = [done + wait for done in self.resets]

    def is_due(self, done: int) -> bool:
        """Return whether `update` changes points after `done` iterations."""
        return done in self.resets or done in self.prunings

    def update(self, done: int, points: TrainablePoints) -> bool:
        """Reset opacities or prune points after `done` iterations, if due. Return whether points were pruned."""
        if done in self.resets:
            reset_opacities(points)
        if done not in self.prunings:
            return False
        points.keep(~faintest(points))
        return True


def reset_opacities(points: TrainablePoints) -> None:
    """Lower all opacities to at most `RESET_OPACITY`, and restart their optimizer state."""
    assert points.origins is None, "the moments are on a device"
    highest = math.log(RESET_OPACITY / (1 - RESET_OPACITY))
    points.adams["logit_opacities"].rewrite(lambda logits: np.minimum(logits, np.float32(highest)), np.zeros_like)


def faintest(points: TrainablePoints) -> np.ndarray:
    """Return the mask [N] of the faintest `PRUNED_SHARE` of all points."""
    opacities = points.opacities
    return opacities < np.quantile(opacities, PRUNED_SHARE)


NEAREST_VIEWS = 4
"""Views that a patch is compared with. The best two count, since others may be occluded."""
PATCH = 5
"""Width of a patch, pixels."""
STEPS, STEP_PIXELS = 8, 0.5
"""Depths in front of the rendered one, and as many behind it; their distance in the median neighboring view, pixels."""
LARGEST_STEP = 0.03
"""Largest distance of two depths, as a share of the rendered inverse depth."""
STEP_COST = 0.03
"""Correlation that a step away from the rendered depth must gain."""
MIN_GAIN, MIN_CORRELATION = 0.1, 0.4
"""A depth replaces the rendered one if its correlation is larger by `MIN_GAIN`, and at least `MIN_CORRELATION`. Measured in
docs/experiments/2026-11-27-plain-walls.md."""
BATCH = 4096
"""Pixels that are searched together. It bounds the memory; OpenCV samples at most 32767 rows at once."""
SMOOTHING = 1.5
"""Standard deviation, pixels, of the filter of inverse depths. The slope of a patch follows from the result."""


@dataclass(frozen=True)
class _Relation:
    """Pose of another view relative to the reference view.

    Attributes:
        rotation: [3, 3] reference to other.
        translation: [3] reference to other, world units.
        K: [3, 3] intrinsics of the other view, pixels.
        gray: [H, W] float32 image of the other view, 0..1; NaN where it is unknown.
    """

    rotation: np.ndarray
    translation: np.ndarray
    K: np.ndarray
    gray: np.ndarray

    def pixels(self, rays: np.ndarray, inverse: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the columns and rows [M, D, P] of points, with pixel centers at integers; NaN behind the view.

        `rays` [M, P, 3] are directions in the reference view with z = 1, at inverse depths [M, D, P].
        """
        x, y, z = ((rays @ self.rotation[axis])[:, None] + self.translation[axis] * inverse for axis in range(3))
        z = np.where(z > 1e-6, z, np.nan)
        return x / z * self.K[0, 0] + self.K[0, 2] - 0.5, y / z * self.K[1, 1] + self.K[1, 2] - 0.5

    def correlation(self, patches: np.ndarray, rays: np.ndarray, inverse: np.ndarray) -> np.ndarray:
        """Return the correlation [M, D] of patches [M, P] with this view at inverse depths [M, D, P]; NaN outside of the image."""
        column, row = self.pixels(rays, inverse)
        height, width = self.gray.shape
        seen = ((column >= 0) & (column <= width - 1) & (row >= 0) & (row <= height - 1)).all(-1)
        x, y = (np.where(seen[..., None], at, 0).reshape(len(at), -1).astype(np.float32) for at in (column, row))
        found = cv2.remap(self.gray, x, y, cv2.INTER_LINEAR).reshape(column.shape)
        return np.where(seen, _correlate(patches[:, None], found), np.nan)


class RayDepths:
    """Depths of single pixels that several training views agree on, searched along the pixels' rays.

    The rendered depth of a plain wall is often wrong where a dot is missing. A point at this depth draws the dot correctly in its
    own view only. A patch around the pixel, with the slope of the rendered surface, is therefore compared with the neighboring
    views at several depths.
    """

    def __init__(self, images: TrainingImages) -> None:
        self.views = images.views
        self.near = images.near
        self.poses = [view.viewmat.astype(np.float64) for view in self.views]
        self.intrinsics = [view.K.astype(np.float64) for view in self.views]
        self.grays = [cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32) / 255 for image in images.pixels[0]]
        if images.unknown is not None:
            for gray, unknown in zip(self.grays, images.unknown[0], strict=True):
                gray[unknown] = np.nan
        centers = np.stack([view.center for view in self.views])
        self.nearest = nearest_poses(centers, np.stack([pose[2, :3] for pose in self.poses]), NEAREST_VIEWS)

    def agreed(self, camera: int, pixels: np.ndarray, depth: np.ndarray, known: np.ndarray) -> np.ndarray:
        """Return the depths [M] of pixels, by row-major number: those that other views agree on, else the rendered ones."""
        rendered = depth.ravel()[pixels].astype(np.float64)
        if len(self.nearest[camera]) < 2:
            return rendered
        surface = _smoothed(1 / depth.astype(np.float64), known)
        for start in range(0, len(pixels), BATCH):
            batch = slice(start, start + BATCH)
            found = self._found(camera, pixels[batch], surface)
            rendered[batch] = np.where(np.isnan(found), rendered[batch], found)
        return rendered

    def _found(self, camera: int, pixels: np.ndarray, surface: np.ndarray) -> np.ndarray:
        """Return the depths [M] that other views agree on; NaN where the rendered one is kept. surface: [H, W] inverse depths."""
        row, column, rays = self._patches(camera, pixels)
        inverse = surface[row, column]
        middle = inverse[:, PATCH**2 // 2]
        others = [self._relation(camera, other) for other in self.nearest[camera]]
        shifts = np.arange(-STEPS, STEPS + 1)
        tried = middle[:, None] + shifts * _steps(others, rays[:, PATCH**2 // 2], middle)[:, None]
        tried = np.minimum(tried, 1 / self.near)
        surfaces = np.maximum(tried[..., None] + (inverse - middle[:, None])[:, None], 0)
        patches = self.grays[camera][row, column]
        scores = np.stack([other.correlation(patches, rays, surfaces) for other in others])
        scores = -np.sort(-np.where(np.isnan(scores), -np.inf, scores), axis=0)[:2].mean(0)
        best = np.argmax(scores - STEP_COST * np.abs(shifts), 1)
        found = scores[np.arange(len(best)), best]
        better = (found > MIN_CORRELATION) & (found > np.maximum(scores[:, STEPS], -1) + MIN_GAIN)
        return np.where(better, 1 / tried[np.arange(len(best)), best], np.nan)

    def _patches(self, camera: int, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the rows and columns [M, P] of the patches around pixels [M], and their rays [M, P, 3] with z = 1."""
        view, K, radius = self.views[camera], self.intrinsics[camera], PATCH // 2
        down, across = np.mgrid[-radius : radius + 1, -radius : radius + 1].reshape(2, -1)
        row = np.clip((pixels // view.width)[:, None] + down, 0, view.height - 1)
        column = np.clip((pixels % view.width)[:, None] + across, 0, view.width - 1)
        x, y = (column + 0.5 - K[0, 2]) / K[0, 0], (row + 0.5 - K[1, 2]) / K[1, 1]
        return row, column, np.stack([x, y, np.ones_like(x)], -1)

    def _relation(self, camera: int, other: int) -> _Relation:
        relative = self.poses[other] @ np.linalg.inv(self.poses[camera])
        return _Relation(relative[:3, :3], relative[:3, 3], self.intrinsics[other], self.grays[other])


def _steps(others: list[_Relation], rays: np.ndarray, inverse: np.ndarray) -> np.ndarray:
    """Return the distance [M] of two inverse depths [M] that moves pixels on rays [M, 3] by `STEP_PIXELS` in the median other view."""
    nearby = np.stack([inverse, 1.01 * inverse], 1)[..., None]
    moved = [np.hypot(*(at[:, 1, 0] - at[:, 0, 0] for at in other.pixels(rays[:, None], nearby))) for other in others]
    moved = np.stack(moved)
    median = np.median(np.where(np.isnan(moved), 0, moved), axis=0)
    return np.minimum(STEP_PIXELS * 0.01 / np.maximum(median, 1e-9), LARGEST_STEP) * inverse


def _smoothed(inverse: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return inverse depths [H, W], averaged over the known pixels around each pixel; unchanged where none is known."""
    weight = cv2.GaussianBlur(known.astype(np.float64), (0, 0), SMOOTHING)
    total = cv2.GaussianBlur(np.where(known, inverse, 0), (0, 0), SMOOTHING)
    return np.where(weight > 1e-6, total / np.maximum(weight, 1e-6), inverse)


def _correlate(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the zero-mean normalized correlation of patches over their last axis. Flat patches have none."""
    a, b = a - a.mean(-1, keepdims=True), b - b.mean(-1, keepdims=True)
    power = (np.square(a).mean(-1) + NOISE**2) * (np.square(b).mean(-1) + NOISE**2)
    return (a * b).mean(-1) / np.sqrt(power)


ADDED_AT = (0.3, 0.4, 0.5, 0.6)
"""Shares of training after which points are added."""
ADDED_SHARE = 0.2
"""Points added at each of these times, as a share of all points."""
SIZE = 0.7
"""Standard deviation of an added point, pixels."""
OPACITY = 0.3
"""Opacity of an added point."""
MIN_ALPHA = 0.5
"""Alpha above which a pixel has a depth."""

Draw = Callable[[int], tuple[Splats, np.ndarray]]
"""Function that returns the projected points of a camera and the image [H, W, 3] that the camera would take of them."""


def adds_after(done: int, total: int) -> bool:
    """Return whether points are added after `done` iterations of `total`."""
    return done in [round(at * total) for at in ADDED_AT]


def points_at_errors(
    draw: Draw, images: TrainingImages, gains: np.ndarray, bands: int, count: int, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """Return up to `count` new points in random pixels, as unconstrained arrays. A pixel's probability is its error times 1 - SSIM.

    Gradients of positions are small where a detail is missing altogether, such as a dot on a plain wall. Errors show it.
    A point takes the color of its pixel, and the depth that neighboring views agree on (`RayDepths`), else the rendered
    depth. `bands` is the number of its harmonics beyond the constant.
    """
    found, ray_depths = [], RayDepths(images)
    for camera, view in enumerate(images.views):
        splats, image = draw(camera)
        target = images.target(0, camera, image, None).astype(np.float32) / 255
        depths = Depths.of(splats, view, images.near)
        known, rendered = depths.alpha > MIN_ALPHA, images.near * np.exp(depths.moments[..., 0])
        pixels = _choose(_errors(image, target) * known, count // len(images.views), rng)
        depth = ray_depths.agreed(camera, pixels, rendered, known).astype(np.float32)
        found.append((*_unproject(view, pixels, depth), target.reshape(-1, 3)[pixels] / gains[camera]))
    means, sizes, colors = (np.concatenate(column) for column in zip(*found, strict=True))
    added = len(means)
    return {
        "means": means,
        "quats": np.tile(np.array([1, 0, 0, 0], np.float32), (added, 1)),
        "log_scales": np.tile(np.log(sizes)[:, None], (1, 3)),
        "logit_opacities": np.full(added, math.log(OPACITY / (1 - OPACITY)), np.float32),
        "sh_base": ((colors - 0.5) / C0)[:, None],
        "sh_rest": np.zeros((added, bands, 3), np.float32),
    }


def _errors(image: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Return the absolute error times the loss of similarity (1 - SSIM) at every pixel [H, W] of images [H, W, 3], 0..1."""
    first, second = (_blurred(x) for x in (image, target))
    variances = _blurred(image * image) - first * first, _blurred(target * target) - second * second
    covariance = _blurred(image * target) - first * second
    c1, c2 = 0.01**2, 0.03**2
    similarity = (2 * first * second + c1) * (2 * covariance + c2)
    similarity /= (first * first + second * second + c1) * (variances[0] + variances[1] + c2)
    return np.abs(image - target).mean(-1) * np.clip(1 - similarity, 0, 1).mean(-1)


def _blurred(image: np.ndarray) -> np.ndarray:
    return cv2.GaussianBlur(image, (11, 11), 1.5)


def _choose(weights: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Return up to `count` different pixels [M] int64 of an image of weights [H, W], each with a probability by its weight."""
    flat = weights.astype(np.float64).ravel()
    count = min(count, int((flat > 0).sum()))
    return rng.choice(len(flat), count, replace=False, p=flat / flat.sum()) if count else np.zeros(0, np.int64)


def _unproject(view: View, pixels: np.ndarray, depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the positions [M, 3] of pixels [M] at depths [M], and the sizes [M] there, world units."""
    row, column = pixels // view.width, pixels % view.width
    x = (column + 0.5 - view.K[0, 2]) / view.K[0, 0] * depth
    y = (row + 0.5 - view.K[1, 2]) / view.K[1, 1] * depth
    local = np.stack([x, y, depth], 1).astype(np.float32)
    return (local - view.viewmat[:3, 3]) @ view.viewmat[:3, :3], SIZE * depth / view.K[0, 0]
