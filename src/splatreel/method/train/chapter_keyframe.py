"""First keyframe of a chapter: content of its first frame that the shared static points lack."""

from __future__ import annotations

import cv2
import numpy as np

from splatreel.base.progress import Progress
from splatreel.config import Config
from splatreel.method.cameras.group_input import GroupInput
from splatreel.method.images.temporal_mean import temporal_mean
from splatreel.method.init.initial_points import InitialPoints, initial_points
from splatreel.method.layering.lift import shares
from splatreel.method.tracking.new_points import error_masks
from splatreel.method.train.keyframe_trainer import KeyframeResult, KeyframeTrainer, starting_points
from splatreel.method.train.losses import CHAPTER_KEYFRAME
from splatreel.method.train.single_frame import train_frame
from splatreel.method.train.stages import known_gains
from splatreel.scene.camera import inside, project
from splatreel.scene.gaussians import Gaussians, StaticPoints

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
    gains = known_gains(data, config)
    trainer = KeyframeTrainer(
        starting_points(points, colors, keyframe, data.unit),
        gains,
        keyframe,
        static=static.living,
        max_points=most,
        losses=CHAPTER_KEYFRAME,
        seed=data.seed,
        region=data.layout.volume(data.cameras),
        gpu=data.gpu,
    )
    images = temporal_mean(data.images) if keyframe.temporal_mean else data.images[0]
    train_frame(
        trainer,
        data.cameras,
        images,
        data.layout,
        keyframe.first_iterations,
        keyframe.coarse_share,
        config,
        progress,
        data.unknown,
        None if data.alpha is None else data.alpha[0],
    )
    return KeyframeResult(trainer.points.gaussians(), gains.values.copy(), static.alive)


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
    """Remove static points that the first frame contradicts.

    Args:
        data: Training views.
        static: Shared static points.
        missing: [C, H, W] bool, pixels that differ from all static points.
        before: Approximate new content, which hides static points behind it.

    Returns:
        The remaining static points, and the pixels that differ from them.
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
    """Return a random choice of points and colors, [P, 3] each.

    Args:
        points: [P, 3] positions.
        colors: [P, 3] 0..1.
        share: Share to keep. A scene of this image size has no room for more; in a sequence the others fade during the first
            keyframe.
        seed: Seed of the choice.
    """
    if share >= 1 or len(points) == 0:
        return points, colors
    keep = np.sort(np.random.default_rng(seed).permutation(len(points))[: max(1, round(share * len(points)))])
    return points[keep], colors[keep]
