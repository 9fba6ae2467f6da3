"""Training of one frame from the frame before: free points, moved points, and points that are added."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from baselines.motion_field import MotionField
from baselines.shared_start import SharedStart
from splatreel.base.progress import Silent
from splatreel.config import KeyframeConfig
from splatreel.kernels import deform, photometric, rasterize
from splatreel.kernels.binning import bin_splats
from splatreel.method.train.cpu_program import check_loss
from splatreel.method.train.density import GROWTH_GRADIENT, GradientMeter, KeyframeDensity, select_growth
from splatreel.method.train.keyframe_trainer import KeyframeTrainer
from splatreel.method.train.losses import KEYFRAME, KEYFRAME_BEFORE_STATIC
from splatreel.method.train.render import NO_CHANGE
from splatreel.method.train.terms.photometric import LAMBDA_DSSIM
from splatreel.method.train.trainable_points import NAMES, TrainablePoints, children, default_rates, to_params
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
    points = TrainablePoints.from_gaussians(before, rates)
    gains, most = start.gains(), max(start.max_points, len(before))
    trainer = KeyframeTrainer(points, gains, config, max_points=most, losses=KEYFRAME, seed=start.config.seed + frame)
    return _fit(trainer, start, images, iterations)


def train_in_place(
    start: SharedStart, before: Gaussians, images: TrainingImages, iterations: int, frame: int
) -> Gaussians:
    """Train positions, rotations, opacities and colors of the points. Sizes and the number of points stay."""
    config = start.config.keyframe
    rates = default_rates(start.layout.unit, config.rate_scale) | {"log_scales": 0.0}
    points = TrainablePoints.from_gaussians(before, rates)
    seed = start.config.seed + frame
    trainer = KeyframeTrainer(points, start.gains(), config, max_points=len(before), losses=KEYFRAME[:1], seed=seed)
    trainer.density = FixedRows(points, config, len(before), seed)
    return _fit(trainer, start, images, iterations)


def move_points(
    start: SharedStart, before: Gaussians, images: TrainingImages, iterations: int, frame: int
) -> tuple[Gaussians, GradientMeter]:
    """Train the motion of all points since the frame before; return the moved points and their screen-space gradients."""
    seed, gains = start.config.seed + frame, start.gains().values
    params = to_params(before)
    means = params["means"]
    field = MotionField(np.array(start.layout.bounds), images.unit, iterations, seed)
    rng, cameras, begin = np.random.default_rng(seed), list[int](), 0
    meter = GradientMeter(len(before))
    for end, shown in images.sizes(iterations, 0.0, start.config.training_megapixels):
        for iteration in range(begin, end):
            cameras = cameras or rng.permutation(len(shown.views)).tolist()
            camera = cameras.pop()
            found = image_gradients(params, field.offsets(means), shown, camera, gains[camera])
            if 2 * iteration >= iterations:
                meter.add(found.screen, shown.views[camera].width, shown.views[camera].height)
            field.step(field.gradient(means, found.points["means"], found.dq), iteration / iterations)
        begin = max(begin, end)
    field.check()
    return before.moved(*field.offsets(means)), meter


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
    parents = TrainablePoints.from_gaussians(moved, rates)
    new = children(parents, grow, np.random.default_rng(seed))
    new = {name: value[: int(grow.sum())] for name, value in new.items()}  # one child of each
    new["logit_opacities"] = np.full_like(new["logit_opacities"], ADDED_LOGIT)
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


class ImageGradients(NamedTuple):
    """Gradients of the photometric loss of one image.

    Attributes:
        loss: The loss.
        points: Gradients to all points by name, see `TrainablePoints`. That to the means is that to dx, too.
        dq: [N, 4] gradient to the rotations; undefined without offsets.
        screen: [N, 2] gradient to the positions in the image, pixels.
    """

    loss: float
    points: dict[str, np.ndarray]
    dq: np.ndarray
    screen: np.ndarray


def image_gradients(
    params: Mapping[str, np.ndarray],
    offsets: tuple[np.ndarray, np.ndarray] | None,
    images: TrainingImages,
    camera: int,
    gain: np.ndarray,
) -> ImageGradients:
    """Draw points and compare them with the first image of a camera.

    Args:
        params: Unconstrained arrays, as in `TrainablePoints`.
        offsets: dx [N, 3] and dq [N, 4], see `render.deformed`; None for points that do not move.
        images: Images.
        camera: Number of the camera.
        gain: [3] its color gain.

    Raises:
        GaussiansError: The loss or a splat is NaN or infinite.
    """
    view = images.views[camera]
    pinhole, background = view.pinhole(images.near), view.background
    dx, dq = NO_CHANGE[:2] if offsets is None else offsets
    moment = deform.DeformedPoints._make([*(params[name] for name in NAMES), dx, dq, NO_CHANGE[2]])
    opacities, seen = deform.forward(moment, view.center, pinhole)
    colors = seen.colors if background is None else seen.colors - background
    bins = bin_splats(seen.means2d, seen.conics, opacities, seen.depths, seen.radii, view.width, view.height)
    image, alpha = rasterize.forward(bins, colors)
    target = images.target(0, camera, image if background is None else image + background, gain)
    compared = photometric.loss_and_gradient(image, target, LAMBDA_DSSIM, gain, background=background)
    check_loss(compared.loss, (seen.means2d, seen.conics, colors, opacities))
    none = rasterize.no_gradient(alpha.shape)
    drawn = rasterize.backward(bins, colors, image, compared.d_image, alpha, none)
    d_splats = drawn.means2d, drawn.conics, drawn.colors, drawn.opacities
    *points, d_dq, _ = deform.backward(moment, seen, view.center, pinhole, *d_splats)
    return ImageGradients(compared.loss, dict(zip(NAMES, points, strict=True)), d_dq, drawn.means2d)


def _fit(trainer: KeyframeTrainer, start: SharedStart, images: TrainingImages, iterations: int) -> Gaussians:
    """Run a trainer at all image sizes and return its points."""
    for end, shown in images.sizes(iterations, 0.0, start.config.training_megapixels):
        if end > trainer.done:
            trainer.train(shown, end - trainer.done, iterations, Silent())
    return trainer.points.gaussians()
