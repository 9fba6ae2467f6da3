"""Reconstruction of one frame as a static scene with 3DGS: the first keyframe of a run, and a baseline."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from splatreel.base.progress import Progress, Silent
from splatreel.config import Config
from splatreel.gpu.shared_gpu import SharedGpu
from splatreel.method.cameras.color_gains import CameraGains
from splatreel.method.init.bodies import subject_hull
from splatreel.method.init.initial_points import InitialPoints, close_surface, initial_points, near_plane
from splatreel.method.init.layout import Layout, border_color, measure
from splatreel.method.init.visual_hull import VisualHull, is_sparse, without_background
from splatreel.method.train.keyframe_trainer import KeyframeTrainer, starting_points
from splatreel.method.train.losses import Terms
from splatreel.method.train.render import View
from splatreel.method.train.subject import with_opposite
from splatreel.method.train.training_images import TrainingImages
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians

LOW_PSNR = 20.0
"""PSNR of training images, dB, below which the user is warned. Noise and short training alone give more."""


@dataclass(frozen=True)
class Subject:
    """The subject that masks show: its opacity [C, H, W] uint8 in the first frame, and the color behind it by camera, 0..1."""

    alpha: np.ndarray
    backgrounds: dict[str, tuple[float, float, float]]


def reconstruct_single_frame(
    cameras: list[Camera],
    images: np.ndarray,
    config: Config,
    *,
    points: np.ndarray | None = None,
    point_colors: np.ndarray | None = None,
    near: float | None = None,
    subject: Subject | None = None,
    gpu: SharedGpu | None = None,
    losses: Terms | None = None,
    progress: Progress | None = None,
) -> tuple[Gaussians, Layout]:
    """Reconstruct one frame as a static scene, like the first keyframe of a run (paper section 5.1). It is not encoded.

    `points` [P, 3] are sparse points of this frame; None triangulates them. `subject` is what masks show. `losses` is a
    list of terms; None is `losses.KEYFRAME`.

    Raises:
        ReconstructionError: If images and cameras do not match.
        GaussiansError: If training ends in NaN or infinity.
    """
    config = config.for_video(1)
    keyframe = config.keyframe
    seeds, layout = lay_out(cameras, images, config, points, point_colors, near, subject)
    gains = CameraGains(len(cameras), config.correct_colors)
    trainer = first_keyframe_trainer(seeds.points, seeds.colors, layout, cameras, gains, config, gpu, losses)
    progress = progress or Silent()
    alpha = subject.alpha if subject is not None and is_sparse(cameras) else None
    if alpha is not None:
        trainer.density.hull = subject_hull(cameras, images, alpha, layout.near)
    iterations, coarse = keyframe.first_iterations, keyframe.coarse_share
    train_frame(trainer, cameras, images, layout, iterations, coarse, config, progress, alpha=alpha)
    gaussians = trainer.points.gaussians()
    gaussians.check_finite("The static reconstruction")
    return gaussians, layout


def lay_out(
    cameras: list[Camera],
    images: np.ndarray,
    config: Config,
    points: np.ndarray | None = None,
    point_colors: np.ndarray | None = None,
    near: float | None = None,
    subject: Subject | None = None,
) -> tuple[InitialPoints, Layout]:
    """Find the initial points of a frame and the measures of the scene.

    `subject` is what masks show, if there are any. The other arguments and errors are those of `initial_points`.
    """
    hull, sparse = None, subject is not None and is_sparse(cameras)
    shown = images
    if subject is not None and sparse:
        hull = subject_hull(cameras, images, subject.alpha, near or 0.0)
        shown = without_background(images, subject.alpha)
    elif subject is not None:
        hull = VisualHull(cameras, subject.alpha, near or 0.0)
    seeds = initial_points(cameras, shown, points, point_colors, near, config.seed, hull)
    layout = replace(measure(cameras, seeds.points, near_plane(cameras, seeds.points)), region=config.region)
    if subject is not None and hull is not None:
        seeds = close_surface(seeds, cameras, shown, hull, layout.unit) if sparse else seeds
        return seeds, replace(layout, backgrounds=subject.backgrounds)
    return seeds, replace(layout, background=border_color(images)) if config.background else layout


def first_keyframe_trainer(
    positions: np.ndarray,
    colors: np.ndarray,
    layout: Layout,
    cameras: list[Camera],
    gains: CameraGains,
    config: Config,
    gpu: SharedGpu | None = None,
    losses: Terms | None = None,
) -> KeyframeTrainer:
    """Create a trainer of all points of a frame."""
    keyframe = config.keyframe
    points = starting_points(positions, colors, keyframe, layout.unit)
    pixels = cameras[0].width * cameras[0].height
    most = min(keyframe.max_points, round(keyframe.points_per_pixel * pixels))
    region = layout.volume(cameras)
    return KeyframeTrainer(
        points, gains, keyframe, max_points=most, losses=losses, seed=config.seed, region=region, gpu=gpu
    )


def train_frame(
    trainer: KeyframeTrainer,
    cameras: list[Camera],
    images: np.ndarray,
    layout: Layout,
    iterations: int,
    coarse_share: float,
    config: Config,
    progress: Progress,
    unknown: np.ndarray | None = None,
    alpha: np.ndarray | None = None,
) -> None:
    """Train on one frame, first at smaller sizes (`TrainingImages.sizes`).

    `unknown` [C, H, W] are pixels without a valid value. `alpha` [C, H, W] uint8 is the opacity of a subject before few
    cameras.
    """
    views = [
        View.of(camera, config.antialias, layout, gain)
        for camera, gain in zip(cameras, trainer.gains.values, strict=True)
    ]
    mask = None if unknown is None else unknown[None]
    training_images = TrainingImages(images[None], views, layout.near, layout.unit, mask)
    if alpha is not None:
        training_images = with_opposite(training_images, alpha[None])
    begin = 0
    for end, shown in training_images.sizes(iterations, coarse_share, config.training_megapixels):
        if end > begin:
            trainer.train(shown, end - begin, iterations, progress)
            begin = end
    progress.update(iterations, points=len(trainer.points))
    if trainer.static is None and (psnr := trainer.psnr(training_images)) < LOW_PSNR:
        why = "the cameras disagree. Check their poses, intrinsics and synchronization"
        progress.note(f"low PSNR of the training images, {psnr:.1f} dB: {why}")
