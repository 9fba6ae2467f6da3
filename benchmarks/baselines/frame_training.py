"""Training of one frame from the frame before: free points, moved points, and points that are added."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from baselines.motion_field import MotionField
from baselines.shared_start import SharedStart
from splatreel.base.progress import Silent
from splatreel.config import KeyframeConfig
from splatreel.method.train.density import GROWTH_GRADIENT, GradientMeter, KeyframeDensity, select_growth
from splatreel.method.train.keyframe_trainer import LAMBDA_DSSIM, KeyframeTrainer
from splatreel.method.train.losses import KEYFRAME, KEYFRAME_BEFORE_STATIC
from splatreel.method.train.render import deformed, draw
from splatreel.method.train.trainable_points import TrainablePoints, children, default_rates
from splatreel.method.train.training_images import TrainingImages
from splatreel.scene.gaussians import Gaussians

DENSIFICATIONS = 5
"""Densifications that a frame would have if all of its iterations densified. Growth ends at 60 %, so three of them are made."""
ADDED_SHARE = 0.02
"""Maximum number of points that are added at a frame, as a share of all points."""
ADDED_LOGIT = -1.0
"""Logit of the opacity of an added point."""


class FixedRows(KeyframeDensity):
    """Density control that never adds or removes a point, so that points keep their identity over time."""

    def update(self, done: int, share: float, images: TrainingImages, averaged: bool, absolute: bool) -> None:
        """Do nothing."""

    def prune(self, unit: float, share: float) -> None:
        """Do nothing."""


def train_freely(
    start: SharedStart, before: Gaussians, images: TrainingImages, iterations: int, frame: int
) -> Gaussians:
    """Train all attributes of the points of the frame before, with density control, as 3DGS does."""
    every = max(iterations // DENSIFICATIONS, 10)
    config = replace(start.config.keyframe, densify_every=every)
    rates = default_rates(start.layout.unit, config.rate_scale)
    points = TrainablePoints.from_gaussians(before, rates, start.device)
    gains, most = start.gains(), max(start.max_points, len(before))
    trainer = KeyframeTrainer(points, gains, config, max_points=most, losses=KEYFRAME, seed=start.config.seed + frame)
    return _fit(trainer, start, images, iterations)


def train_in_place(
    start: SharedStart, before: Gaussians, images: TrainingImages, iterations: int, frame: int
) -> Gaussians:
    """Train positions, rotations, opacities and colors of the points. Sizes and the number of points stay."""
    config = start.config.keyframe
    rates = default_rates(start.layout.unit, config.rate_scale) | {"log_scales": 0.0}
    points = TrainablePoints.from_gaussians(before, rates, start.device)
    seed = start.config.seed + frame
    trainer = KeyframeTrainer(points, start.gains(), config, max_points=len(before), losses=KEYFRAME[:1], seed=seed)
    trainer.density = FixedRows(points, config, len(before), seed)
    return _fit(trainer, start, images, iterations)


def move_points(
    start: SharedStart, before: Gaussians, images: TrainingImages, iterations: int, frame: int
) -> tuple[Gaussians, GradientMeter]:
    """Train the motion of all points since the frame before; return the moved points and their screen-space gradients."""
    seed, gains = start.config.seed + frame, start.gains().values
    points = TrainablePoints.from_gaussians(before, default_rates(images.unit), start.device)
    params = {name: tensor.detach() for name, tensor in points.params.items()}
    means = params["means"]
    field = MotionField(means, np.array(start.layout.bounds), images.unit, iterations, seed)
    rng, cameras, begin = np.random.default_rng(seed), list[int](), 0
    meter = GradientMeter(len(before), start.device)
    for end, shown in images.sizes(iterations, 0.0, start.config.training_megapixels):
        for iteration in range(begin, end):
            cameras = cameras or rng.permutation(len(shown.views)).tolist()
            camera = cameras.pop()
            view = shown.views[camera]
            drawing = draw(deformed(params, field.offsets(means), None, view, shown.near), view)
            target = shown.target(0, camera, drawing.image, gains[camera])
            drawing.loss(target, LAMBDA_DSSIM, gains[camera]).backward()
            grad = drawing.means2d.grad
            assert grad is not None
            if 2 * iteration >= iterations:
                meter.add(grad, view.width, view.height)
            field.step(iteration / iterations)
        begin = max(begin, end)
    field.check()
    with torch.no_grad():
        dx, dq = field.offsets(means)
    return before.moved(dx.cpu().numpy(), dq.cpu().numpy()), meter


def add_points(
    start: SharedStart, moved: Gaussians, meter: GradientMeter, images: TrainingImages, iterations: int, frame: int
) -> Gaussians:
    """Return points that a frame needs in addition, where moved points have large gradients. Few iterations add none."""
    room = min(start.max_points - len(moved), round(ADDED_SHARE * len(moved)))
    grow = select_growth(meter, GROWTH_GRADIENT, room)
    if iterations < len(images.views) or not bool(grow.any()):
        return moved[:0]
    config: KeyframeConfig = replace(start.config.keyframe, densify_every=iterations)
    seed = start.config.seed + frame
    rates = default_rates(start.layout.unit, config.rate_scale)
    parents = TrainablePoints.from_gaussians(moved, rates, start.device)
    new = children(parents, grow, torch.Generator().manual_seed(seed))
    new = {name: value[: int(grow.sum())] for name, value in new.items()}  # one child of each
    new["logit_opacities"] = torch.full_like(new["logit_opacities"], ADDED_LOGIT)
    trainer = KeyframeTrainer(
        TrainablePoints(new, rates),
        start.gains(),
        config,
        static=moved,
        max_points=len(new["means"]),
        losses=KEYFRAME_BEFORE_STATIC,
        seed=seed,
    )
    return _fit(trainer, start, images, iterations)


def _fit(trainer: KeyframeTrainer, start: SharedStart, images: TrainingImages, iterations: int) -> Gaussians:
    """Run a trainer at all image sizes and return its points."""
    for end, shown in images.sizes(iterations, 0.0, start.config.training_megapixels):
        if end > trainer.done:
            trainer.train(shown, end - trainer.done, iterations, Silent())
    return trainer.points.gaussians()
