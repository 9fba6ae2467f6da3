"""The first keyframe of a chapter: what its first frame shows that the scene's shared static points lack."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from splatreel.config import Config
from splatreel.motion.lift import shares
from splatreel.motion.new_points import error_masks
from splatreel.motion.temporal_mean import temporal_mean
from splatreel.progress import Progress
from splatreel.recon.cameras.group_input import GroupInput
from splatreel.recon.init.initialise import initial_points
from splatreel.recon.init.planesweep import inside, project
from splatreel.recon.train.keyframe import KeyframeTrainer, starting_points
from splatreel.recon.train.single_frame import train_frame
from splatreel.recon.train.stages import gains_of
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.static_points import StaticPoints

AROUND = 7
"""Pixels, across, by which what is missing is widened in a picture 320 wide: edges differ less than what they enclose."""
GONE = 0.6
"""Share of what a static point shows that must lie where pictures differ for it to be taken out."""
MISSING = 0.5
"""Share of the cameras before which a place lies, two at least, in whose pictures something must be missing there."""


@dataclass(frozen=True)
class ChapterStart:
    """points: what is there beside the static ones. gains: [C, 3], of the cameras. alive: [S] bool, of the static points."""

    points: Gaussians
    gains: np.ndarray
    alive: np.ndarray


def start_chapter(data: GroupInput, static: StaticPoints, config: Config, progress: Progress) -> ChapterStart:
    """Compare the first frame with the shared static points, take out those that are wrong, and train new points where some lack.

    The static points stay frozen. New ones begin where the first frame alone would put them, as far as cameras agree that something
    is missing there.
    """
    missing = missing_in(data, static)
    gone = shares(static.living, data.cameras, missing, data.near, data.device) > GONE
    static = static.without(gone)
    points, colors = _places(data, missing)
    if len(points) == 0:
        return ChapterStart(Gaussians.empty(config.keyframe.sh_degree), data.gains, static.alive)
    keyframe = config.keyframe
    pixels = data.cameras[0].width * data.cameras[0].height
    most = min(keyframe.max_points, round(keyframe.points_per_pixel * pixels))
    gains = gains_of(data, config)
    trainer = KeyframeTrainer(
        starting_points(points, colors, keyframe, data.unit, data.device),
        gains,
        keyframe,
        static=static.living,
        max_points=most,
        seed=data.seed,
    )
    images = temporal_mean(data.images) if keyframe.temporal_mean else data.images[0]
    train_frame(
        trainer,
        data.cameras,
        images,
        data.layout,
        keyframe.first_iterations,
        keyframe.coarse_share,
        data.antialias,
        progress,
    )
    return ChapterStart(trainer.points.gaussians(), gains.values.cpu().numpy(), static.alive)


def missing_in(data: GroupInput, static: StaticPoints) -> np.ndarray:
    """[C, H, W] bool: where the first frame shows something else than the static points."""
    kernel = np.ones((size := max(3, round(AROUND * data.cameras[0].width / 320) | 1), size), np.uint8)
    found = []
    for camera, image, gain in zip(data.cameras, data.images[0], data.gains, strict=True):
        masks = error_masks(data.draw(static.living, camera) * gain, image)
        found.append(cv2.dilate(masks.error.astype(np.uint8), kernel) > 0)
    return np.stack(found)


def _places(data: GroupInput, missing: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Initial points [P, 3] of the first frame and their colors [P, 3] 0..1, of those where cameras agree that something is missing."""
    if not missing.any():
        return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32)
    found = initial_points(data.cameras, data.images[0], seed=data.seed)
    seen, lacking = np.zeros(len(found.points)), np.zeros(len(found.points))
    for camera, mask in zip(data.cameras, missing, strict=True):
        pixels, depth = project(camera, found.points)
        there = inside(camera, pixels) & (depth > data.near)
        column, row = np.floor(pixels[there]).astype(np.int64).T
        seen += there
        lacking[there] += mask[row, column]
    keep = lacking >= np.maximum(2, MISSING * seen)
    return found.points[keep], found.colors[keep]
