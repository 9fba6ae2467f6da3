"""Comparison of an imported reel with its source sequence, and diagnosis of differences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from splatreel.base.errors import GaussiansError
from splatreel.base.progress import Progress
from splatreel.evaluation.metrics import psnr
from splatreel.importing.frames import Frames
from splatreel.play.timeline import Timeline, draw_on_cpu, open_reel
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians

COMPARED, SIDE = 12, 768
"""Maximum number of compared images, and of pixels along their longer side."""
GLANCES, GLANCE_SIDE = 12, 192
"""Maximum number of cameras tried to find one with a non-empty view, and pixels along the longer side of these images."""
CLOSE = 40.0
"""PSNR in dB above which reel and sequence look the same."""
FAR = 1000.0
"""A point is an outlier beyond this many times the distance of nearly all points from their median."""
BLACK = (0.0, 0.0, 0.0)
MAGENTA, GRAY_LEVEL = (1.0, 0.0, 1.0), 1 / 255
"""Background that no sequence has, and maximum deviation of an empty image from it."""


@dataclass(frozen=True)
class Comparison:
    """Result of a comparison.

    Attributes:
        psnr: Mean PSNR in dB of the decoded reel against the sequence in the file's own precision.
        blind: Names of cameras that saw nothing of the sequence.
        cause: Cause and remedy of a PSNR below `CLOSE`; None if the PSNR is high enough or the cause is unknown.
    """

    psnr: float
    images: int
    blind: Sequence[str] = ()
    cause: str | None = None


def check_seen(frames: Frames, cameras: list[Camera], near: float, antialias: bool, whose: str) -> None:
    """Raise `GaussiansError` if no camera sees anything of the sequence.

    Args:
        frames: Source sequence.
        cameras: Cameras to try.
        near: Near plane, world units.
        antialias: How splats are drawn, see `render_image`.
        whose: Origin of the cameras, for the message.
    """
    some = cameras[:: -(-len(cameras) // GLANCES)]
    for frame in dict.fromkeys((0, len(frames) // 2, len(frames) - 1)):
        for camera in some:
            points, glance = _centered(frames, frame, camera.at_most(GLANCE_SIDE))
            if not _is_blank(points, glance, near, antialias):
                return
    raise GaussiansError(
        f"{frames.path}: {whose} see nothing of the sequence: all their images are empty. Name the cameras that it was trained on "
        f"(--cameras), in the same coordinates. Without --cameras, a ring of cameras around all points is used."
    )


def compare(frames: Frames, reel: Path, progress: Progress, antialias: bool) -> Comparison:
    """Compare images of some frames of the sequence and the reel, cycling through the cameras.

    Args:
        frames: Source sequence.
        reel: Folder of the reel.
        progress: Progress display.
        antialias: How splats of the sequence are drawn, see `render_image`.

    Raises:
        GaussiansError: All images are empty.
    """
    timeline = open_reel(reel)
    cameras = [camera.at_most(SIDE) for camera in timeline.manifest.cameras]
    chosen = np.unique(np.linspace(0, len(frames) - 1, COMPARED).round().astype(int))
    progress.stage("comparing images", len(chosen))
    pairs, blind = [], {}
    for number, frame in enumerate(chosen.tolist()):
        if not len(frames.read(frame)):
            continue
        first = number * len(cameras) // len(chosen)
        for camera in [*cameras[first:], *cameras[:first]][:GLANCES]:
            pair = _pair(frames, timeline, frame, camera, antialias)
            if pair is not None:
                pairs.append((frame, *pair))
                break
            blind[camera.name] = None
        progress.update(number + 1)
    if not pairs:
        raise GaussiansError(
            f"{frames.path}: its cameras see nothing of the frames that were compared. Check --cameras."
        )
    values = [psnr(shown, truth) for _, truth, shown in pairs]
    mean = float(np.mean(values))
    cause = None
    if mean < CLOSE:
        cause = _diagnose(frames.read(pairs[int(np.argmin(values))][0]))
    return Comparison(mean, len(pairs), tuple(blind), cause)


def _pair(
    frames: Frames, timeline: Timeline, frame: int, camera: Camera, antialias: bool
) -> tuple[np.ndarray, np.ndarray] | None:
    points, centered = _centered(frames, frame, camera)
    reel = timeline.manifest
    if _is_blank(points, centered, reel.near, antialias):
        return None
    truth = draw_on_cpu(points, centered, reel.near, antialias, BLACK)
    shown = timeline.render(timeline.at(frame / timeline.fps), camera)
    return np.clip(truth, 0, 1), np.clip(shown, 0, 1)


def _centered(frames: Frames, frame: int, camera: Camera) -> tuple[Gaussians, Camera]:
    """Return a frame and a camera, both moved so that the camera is at the origin.

    Positions are moved before they are rounded to float32, which keeps precision far from the file's origin.
    """
    viewmat = camera.viewmat.astype(np.float64)
    center = -np.linalg.solve(viewmat[:3, :3], viewmat[:3, 3])
    turned = viewmat.copy()
    turned[:3, 3] = 0
    return frames.read(frame, center), replace(camera, viewmat=turned)


def _is_blank(points: Gaussians, camera: Camera, near: float, antialias: bool) -> bool:
    drawn = draw_on_cpu(points, camera, near, antialias, MAGENTA)
    return bool(np.abs(drawn - np.array(MAGENTA, np.float32)).max() < GRAY_LEVEL)


def _diagnose(points: Gaussians) -> str | None:
    """Return a cause of a low PSNR: moving points so far away that positions are stored coarsely; None if unknown."""
    means = points.means.astype(np.float64)
    away = np.linalg.norm(means - np.median(means, axis=0), axis=1)
    usual = float(np.quantile(away, 0.95))
    far = np.flatnonzero(away > FAR * usual)
    if not len(far):
        return None
    return (
        f"{len(far):,} points, such as number {far[0]} (counted from 0), are {away[far].max():.3g} away from the middle, where nearly "
        f"all others are within {usual:.3g}, and move, so that positions are stored coarsely. Remove them with --crop."
    )
