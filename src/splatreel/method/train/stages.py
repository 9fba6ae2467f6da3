"""Training stages of a run: the first keyframe of a video or a chapter, later keyframes, and groups."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

import cv2
import numpy as np

from splatreel.base.progress import Progress
from splatreel.config import Config
from splatreel.method.cameras.color_gains import CameraGains
from splatreel.method.cameras.group_input import GroupInput
from splatreel.method.cameras.time_offsets import TimeOffsets
from splatreel.method.images.temporal_mean import temporal_mean
from splatreel.method.init.initial_points import InitialPoints, initial_points
from splatreel.method.layering.labels import convertible
from splatreel.method.layering.lift import shares
from splatreel.method.tracking.new_points import error_masks
from splatreel.method.tracking.tracking import GroupStart
from splatreel.method.train.group_trainer import GroupResult, GroupTrainer
from splatreel.method.train.keyframe_trainer import KeyframeResult, KeyframeTrainer, starting_points
from splatreel.method.train.losses import CHAPTER_KEYFRAME, KEYFRAME, KEYFRAME_BEFORE_STATIC
from splatreel.method.train.render import View
from splatreel.method.train.single_frame import first_keyframe_trainer, train_frame
from splatreel.method.train.subject import with_opposite
from splatreel.method.train.trainable_points import TrainablePoints, default_rates
from splatreel.method.train.training_images import TrainingImages
from splatreel.scene.camera import inside, project
from splatreel.scene.gaussians import Gaussians, StaticPoints


class KeyframeWatch(Protocol):
    """Receiver of the points of the first keyframe of a video."""

    def show(self, gaussians: Callable[[], Gaussians]) -> None:
        """Look at the points during training. `gaussians` returns the points as they are now."""
        ...

    def finish(self, points: Gaussians) -> None:
        """Look at the trained points of a keyframe."""
        ...


def train_first_keyframe(
    data: GroupInput,
    positions: np.ndarray,
    colors: np.ndarray,
    config: Config,
    progress: Progress,
    unknown: np.ndarray | None = None,
    watch: Callable[[Callable[[], Gaussians]], None] | None = None,
) -> KeyframeResult:
    """Train all points of the first group's keyframe, from initial points.

    `unknown` [C, H, W] are pixels without a valid value. `watch` is called with a function that returns the points as
    they are now.
    """
    keyframe, gains = config.keyframe, known_gains(data, config)
    trainer = first_keyframe_trainer(positions, colors, data.layout, data.cameras, gains, config, data.gpu)
    trainer.watch = watch
    trainer.density.hull = data.find_hull()
    return _trained(data, trainer, keyframe.first_iterations, keyframe.coarse_share, config, progress, unknown)


def refine_keyframe(
    data: GroupInput, dynamic: Gaussians, static: StaticPoints, config: Config, progress: Progress
) -> KeyframeResult:
    """Train the dynamic points of a later keyframe, starting from the previous group, in front of frozen static points."""
    keyframe = config.keyframe
    points = TrainablePoints.from_gaussians(dynamic, default_rates(data.unit, keyframe.rate_scale))
    most = len(points) + max(1000, len(points) // 3)
    gains, behind = known_gains(data, config), static.living
    trainer = KeyframeTrainer(
        points,
        gains,
        keyframe,
        static=behind,
        max_points=most,
        losses=KEYFRAME_BEFORE_STATIC if len(behind) else KEYFRAME,
        seed=data.seed,
        region=data.layout.volume(data.cameras),
        gpu=data.gpu,
    )
    trainer.density.hull = data.find_hull()
    return _trained(data, trainer, keyframe.refine_iterations, 0.0, config, progress)


def train_group(
    data: GroupInput, start: GroupStart, static: StaticPoints, config: Config, progress: Progress
) -> GroupResult:
    """Train the motion of a group's dynamic points from an initial state."""
    trainer = group_trainer(data, start, static, config, convertible(data, static, config.layering.adapt_changed_share))
    found = trainer.train(progress)
    found.dynamic.check_finite(f"Group {data.span.index}")
    return found


def group_trainer(
    data: GroupInput, start: GroupStart, static: StaticPoints, config: Config, may_move: np.ndarray | None = None
) -> GroupTrainer:
    """Create the trainer of a group. `may_move` [S]: static points that may be converted; None allows all living points."""
    gains = known_gains(data, config)
    views = [
        View.of(camera, data.antialias, data.layout, gain)
        for camera, gain in zip(data.cameras, gains.values, strict=True)
    ]
    time_offsets = TimeOffsets(len(data.cameras), config.group.time_offsets)
    time_offsets.load(data.time_offsets)
    shown = TrainingImages(data.images, views, data.near, data.unit, array=data.images)
    return GroupTrainer(
        shown if data.alpha is None else with_opposite(shown, data.alpha),
        start,
        static,
        config,
        gains=gains,
        time_offsets=time_offsets,
        may_move=may_move,
        seed=data.seed + data.span.index,
        missing=data.missing,
        region=data.layout.volume(data.cameras),
        gpu=data.gpu,
    )


def known_gains(data: GroupInput, config: Config) -> CameraGains:
    """Return the color gains that are known so far, to be refined."""
    gains = CameraGains(len(data.cameras), config.correct_colors)
    gains.load(data.gains)
    return gains


def _trained(
    data: GroupInput,
    trainer: KeyframeTrainer,
    iterations: int,
    coarse: float,
    config: Config,
    progress: Progress,
    unknown: np.ndarray | None = None,
) -> KeyframeResult:
    images = temporal_mean(data.images) if config.keyframe.temporal_mean else data.images[0]
    unknown = data.unknown if unknown is None else unknown
    alpha = None if data.alpha is None else data.alpha[0]
    train_frame(trainer, data.cameras, images, data.layout, iterations, coarse, config, progress, unknown, alpha)
    return KeyframeResult(trainer.points.gaussians(), trainer.gains.values.copy())


DILATION = 7
"""Width by which masks of missing content are dilated, in pixels of an image 320 wide. Edges differ less than the area they
enclose."""
DEPARTED_SHARE = 0.6
"""A shared static point is removed if more than this share of its contribution lies in wrong pixels."""
MAX_PASSES = 3
"""Passes of the search for such points. Removing front points can expose further wrong ones."""
MISSING_SHARE = 0.5
"""Share of the cameras seeing a place, at least two, in whose images content must be missing there."""


def start_chapter(data: GroupInput, static: StaticPoints, config: Config, progress: Progress) -> KeyframeResult:
    """Remove shared static points that the first frame contradicts, and train new points where content is missing.

    The static points stay frozen. New points start at the initial points of the first frame where cameras agree that content is
    missing. Static points that new content merely hides are kept.
    """
    keyframe = config.keyframe
    missing = missing_in(data, static)
    if not missing.any():
        return KeyframeResult(Gaussians.empty(keyframe.sh_degree), data.gains, static.alive)
    pixels = data.cameras[0].width * data.cameras[0].height
    most = min(keyframe.max_points, round(keyframe.points_per_pixel * pixels))
    found = initial_points(data.cameras, data.images[0], seed=data.seed)
    static, missing = _remove_departed(data, static, missing, _occluders(data, found, missing, config))
    points, colors = _thinned(*_places(data, found, missing), most / max(len(found.points), 1), data.seed)
    if len(points) == 0:
        return KeyframeResult(Gaussians.empty(keyframe.sh_degree), data.gains, static.alive)
    trainer = KeyframeTrainer(
        starting_points(points, colors, keyframe, data.unit),
        known_gains(data, config),
        keyframe,
        static=static.living,
        max_points=most,
        losses=CHAPTER_KEYFRAME,
        seed=data.seed,
        region=data.layout.volume(data.cameras),
        gpu=data.gpu,
    )
    trained = _trained(data, trainer, keyframe.first_iterations, keyframe.coarse_share, config, progress)
    return replace(trained, alive=static.alive)


def missing_in(data: GroupInput, static: StaticPoints) -> np.ndarray:
    """Return masks [C, H, W] bool of the pixels in which the first frame differs from the static points, where it exists."""
    kernel = np.ones((size := max(3, round(DILATION * data.cameras[0].width / 320) | 1), size), np.uint8)
    found = []
    for camera, image, gain in zip(data.cameras, data.images[0], data.gains, strict=True):
        masks = error_masks(data.draw(static.living, camera) * gain, image)
        found.append(cv2.dilate(masks.error.astype(np.uint8), kernel) > 0)
    masks = np.stack(found)
    return masks if data.unknown is None else masks & ~data.unknown


def _remove_departed(
    data: GroupInput, static: StaticPoints, missing: np.ndarray, before: Gaussians
) -> tuple[StaticPoints, np.ndarray]:
    """Remove static points that the first frame contradicts. Return the remaining ones, and the pixels that differ from them.

    `missing` [C, H, W] differ from all static points. `before` is approximate new content, which hides static points
    behind it.
    """
    for _ in range(MAX_PASSES):
        everything = Gaussians.concatenate([static.living, before])
        seen = shares(everything, data.cameras, missing, data.near)[: len(static.living)]
        gone = seen > DEPARTED_SHARE  # unseen points are NaN, which compares false
        if not gone.any():
            break
        static = static.without(gone)
        missing = missing_in(data, static)
    return static, missing


def _occluders(data: GroupInput, found: InitialPoints, missing: np.ndarray, config: Config) -> Gaussians:
    """Return the initial points where content is missing, nearly opaque: they hide what is behind them."""
    points, colors = _places(data, found, missing)
    if len(points) == 0:
        return Gaussians.empty(config.keyframe.sh_degree)
    covers = starting_points(points, colors, config.keyframe, data.unit).gaussians()
    return Gaussians(covers.means, covers.quats, covers.scales, np.full(len(points), 0.95), covers.sh)


def _places(data: GroupInput, found: InitialPoints, missing: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the initial points [P, 3] and colors [P, 3] 0..1 at which cameras agree that content is missing."""
    seen, lacking = np.zeros(len(found.points)), np.zeros(len(found.points))
    for camera, mask in zip(data.cameras, missing, strict=True):
        pixels, depth = project(camera, found.points)
        there = inside(camera, pixels) & (depth > data.near)
        column, row = np.floor(pixels[there]).astype(np.int64).T
        seen += there
        lacking[there] += mask[row, column]
    keep = lacking >= np.maximum(2, MISSING_SHARE * seen)
    return found.points[keep], found.colors[keep]


def _thinned(points: np.ndarray, colors: np.ndarray, share: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a random share of points and colors, [P, 3] each.

    A scene of this image size has no room for more. In a sequence the others fade during the first keyframe.
    """
    if share >= 1 or len(points) == 0:
        return points, colors
    keep = np.sort(np.random.default_rng(seed).permutation(len(points))[: max(1, round(share * len(points)))])
    return points[keep], colors[keep]
