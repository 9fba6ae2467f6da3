"""Training stages of a run: the first keyframe, later keyframes and groups."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from splatreel.base.progress import Progress
from splatreel.config import Config
from splatreel.method.cameras.color_gains import CameraGains
from splatreel.method.cameras.group_input import GroupInput
from splatreel.method.cameras.time_offsets import TimeOffsets
from splatreel.method.images.temporal_mean import temporal_mean
from splatreel.method.layering.labels import convertible
from splatreel.method.tracking.tracking import GroupStart
from splatreel.method.train.group_trainer import GroupResult, GroupTrainer
from splatreel.method.train.keyframe_trainer import KeyframeResult, KeyframeTrainer
from splatreel.method.train.losses import KEYFRAME, KEYFRAME_BEFORE_STATIC
from splatreel.method.train.opposite_backgrounds import with_opposite
from splatreel.method.train.render import View
from splatreel.method.train.single_frame import first_keyframe_trainer, train_frame
from splatreel.method.train.trainable_points import TrainablePoints, default_rates
from splatreel.method.train.training_images import TrainingImages
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

    Args:
        data: Training views of the group.
        positions: [P, 3] world.
        colors: [P, 3] 0..1.
        config: Settings.
        progress: Receives the current iteration.
        unknown: [C, H, W] bool, pixels without a valid value; None if all are valid.
        watch: Called during training with a function that returns the points as they are now.
    """
    keyframe, gains = config.keyframe, known_gains(data, config)
    trainer = first_keyframe_trainer(positions, colors, data.layout, data.cameras, gains, config, data.gpu)
    trainer.watch = watch
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
    """Create the trainer of a group.

    Args:
        data: Training views of the group.
        start: Initial state.
        static: Static points.
        config: Settings.
        may_move: [S] bool, static points that may be converted; None allows all living points.
    """
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
    trainer.density.hull = data.hull
    alpha = None if data.alpha is None else data.alpha[0]
    train_frame(trainer, data.cameras, images, data.layout, iterations, coarse, config, progress, unknown, alpha)
    return KeyframeResult(trainer.points.gaussians(), trainer.gains.values.copy())
