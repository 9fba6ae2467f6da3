"""One frame as a scene of its own: standard 3DGS from its images alone. The first keyframe of a run is one, and the yardstick."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from splatreel.config import Config
from splatreel.progress import Progress, Silent
from splatreel.recon.cameras.color_gains import CameraGains
from splatreel.recon.init.initialise import InitialPoints, initial_points, near_plane
from splatreel.recon.init.layout import Layout, border_color, measure
from splatreel.recon.train.keyframe import KeyframeTrainer, starting_points
from splatreel.recon.train.pictures import Pictures
from splatreel.recon.train.render import View
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians

POOR = 20.0
"""dB on the training views of a scene below which its user hears of it: pictures of noise and haste alone have more."""


def reconstruct_single_frame(
    cameras: list[Camera],
    images: np.ndarray,
    config: Config,
    *,
    points: np.ndarray | None = None,
    point_colors: np.ndarray | None = None,
    near: float | None = None,
    device: torch.device | None = None,
    progress: Progress | None = None,
) -> tuple[Gaussians, Layout]:
    """Reconstruct one frame as a static scene, as the first keyframe of a run is (paper section 5.1); not encoded.

    images: [C, H, W, 3] uint8 of the training cameras. points: [P, 3] and point_colors: [P, 3] 0..1, sparse points of this very
    frame, if any. near: nothing is closer to a camera than this, world units. device: the CPU by default. progress: it
    has `first_iterations` steps. Raises `ReconstructionError` if images and cameras do not fit, `GaussiansError` if training
    ends in numbers that are not finite.
    """
    keyframe = config.keyframe
    seeds, layout = lay_out(cameras, images, config, points, point_colors, near)
    gains = CameraGains(len(cameras), device or torch.device("cpu"), config.correct_colors)
    trainer = first_keyframe_trainer(seeds.points, seeds.colors, layout, cameras, gains, config)
    progress = progress or Silent()
    train_frame(trainer, cameras, images, layout, keyframe.first_iterations, keyframe.coarse_share, config, progress)
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
) -> tuple[InitialPoints, Layout]:
    """Initial points of a frame and the measures of the scene. Other arguments and errors are those of `initial_points`."""
    seeds = initial_points(cameras, images, points, point_colors, near, config.seed)
    layout = measure(cameras, seeds.points, near_plane(cameras, seeds.points))
    return seeds, replace(layout, background=border_color(images)) if config.background else layout


def first_keyframe_trainer(
    positions: np.ndarray,
    colors: np.ndarray,
    layout: Layout,
    cameras: list[Camera],
    gains: CameraGains,
    config: Config,
) -> KeyframeTrainer:
    """A trainer of all points of a frame, on the device of the gains. positions: [P, 3] world. colors: [P, 3] 0..1."""
    keyframe = config.keyframe
    points = starting_points(positions, colors, keyframe, layout.unit, gains.values.device)
    pixels = cameras[0].width * cameras[0].height
    most = min(keyframe.max_points, round(keyframe.points_per_pixel * pixels))
    return KeyframeTrainer(points, gains, keyframe, max_points=most, seed=config.seed)


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
) -> None:
    """Train on one frame, at first in smaller sizes (`Pictures.sizes`). images: [C, H, W, 3] uint8.

    unknown: [C, H, W] bool, where they mean nothing.
    """
    device = trainer.points.means.device
    views = [View.of(camera, device, config.antialias, layout) for camera in cameras]
    mask = None if unknown is None else torch.from_numpy(unknown).to(device)
    pictures = Pictures(torch.from_numpy(images).to(device)[None], views, layout.near, layout.unit, mask)
    begin = 0
    for end, shown in pictures.sizes(iterations, coarse_share, config.training_megapixels):
        if end > begin:
            trainer.train(shown, end - begin, iterations, progress)
            begin = end
    progress.update(iterations, points=len(trainer.points))
    if trainer.static is None and (psnr := trainer.psnr(pictures)) < POOR:
        why = "the cameras do not agree on what they see. Are their poses, lenses and clocks right?"
        progress.note(f"the pictures that were trained on come out with {psnr:.1f} dB only: {why}")
