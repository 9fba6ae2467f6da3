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
from splatreel.recon.init.initialise import InitialPoints, initial_points
from splatreel.recon.init.planesweep import inside, project
from splatreel.recon.train.keyframe import KeyframeTrainer, starting_points
from splatreel.recon.train.losses import CHAPTER_KEYFRAME
from splatreel.recon.train.single_frame import train_frame
from splatreel.recon.train.stages import gains_of
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.static_points import StaticPoints

AROUND = 7
"""Pixels, across, by which what is missing is widened in a picture 320 wide: edges differ less than what they enclose."""
GONE = 0.6
"""Share of what is seen of a static point that must lie where pictures differ for it to be taken out."""
PEELS = 3
"""Times that one looks for such points: behind those of a thing are others of it, which show once the first are gone."""
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
    is missing there. What they hide has not gone.
    """
    keyframe = config.keyframe
    missing = missing_in(data, static)
    if not missing.any():
        return ChapterStart(Gaussians.empty(keyframe.sh_degree), data.gains, static.alive)
    pixels = data.cameras[0].width * data.cameras[0].height
    most = min(keyframe.max_points, round(keyframe.points_per_pixel * pixels))
    found = initial_points(data.cameras, data.images[0], seed=data.seed)
    static, missing = _without_gone(data, static, missing, _covers(data, found, missing, config))
    points, colors = _thinned(*_places(data, found, missing), most / max(len(found.points), 1), data.seed)
    if len(points) == 0:
        return ChapterStart(Gaussians.empty(keyframe.sh_degree), data.gains, static.alive)
    gains = gains_of(data, config)
    trainer = KeyframeTrainer(
        starting_points(points, colors, keyframe, data.unit, data.device),
        gains,
        keyframe,
        static=static.living,
        max_points=most,
        losses=CHAPTER_KEYFRAME,
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
        config,
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


def _without_gone(
    data: GroupInput, static: StaticPoints, missing: np.ndarray, before: Gaussians
) -> tuple[StaticPoints, np.ndarray]:
    """The static points without those that have gone, and what is missing then, [C, H, W] bool.

    missing: of all of them. before: about what is new, which hides what is behind it.
    """
    for _ in range(PEELS):
        everything = Gaussians.concatenate([static.living, before])
        seen = shares(everything, data.cameras, missing, data.near, data.device)[: len(static.living)]
        gone = seen > GONE  # of NaN, which no camera sees, all comparisons are false
        if not gone.any():
            break
        static = static.without(gone)
        missing = missing_in(data, static)
    return static, missing


def _covers(data: GroupInput, found: InitialPoints, missing: np.ndarray, config: Config) -> Gaussians:
    """The initial points where something is missing, as things that hide what is behind them."""
    points, colors = _places(data, found, missing)
    if len(points) == 0:
        return Gaussians.empty(config.keyframe.sh_degree)
    covers = starting_points(points, colors, config.keyframe, data.unit, data.device).gaussians()
    return Gaussians(covers.means, covers.quats, covers.scales, np.full(len(points), 0.95), covers.sh)


def _places(data: GroupInput, found: InitialPoints, missing: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Initial points [P, 3] of the first frame and their colors [P, 3] 0..1, of those where cameras agree that something is missing."""
    seen, lacking = np.zeros(len(found.points)), np.zeros(len(found.points))
    for camera, mask in zip(data.cameras, missing, strict=True):
        pixels, depth = project(camera, found.points)
        there = inside(camera, pixels) & (depth > data.near)
        column, row = np.floor(pixels[there]).astype(np.int64).T
        seen += there
        lacking[there] += mask[row, column]
    keep = lacking >= np.maximum(2, MISSING * seen)
    return found.points[keep], found.colors[keep]


def _thinned(points: np.ndarray, colors: np.ndarray, share: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A random choice of points and colors, [P, 3] each.

    share: of them that a scene of such pictures can have. In a sequence the others fade while its first keyframe is trained, and few of
    them come to move.
    """
    if share >= 1 or len(points) == 0:
        return points, colors
    keep = np.sort(np.random.default_rng(seed).permutation(len(points))[: max(1, round(share * len(points)))])
    return points[keep], colors[keep]
