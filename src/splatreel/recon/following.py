"""The start of a group: tracks of its dynamic points by flow, and new points for what appears (before any training)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from splatreel.kernels.image import render_image
from splatreel.motion.appear import find, wrong_pixels
from splatreel.motion.flow import Flow
from splatreel.motion.leap import leaps
from splatreel.motion.track import Tracker, Trail, identity
from splatreel.progress import Progress
from splatreel.recon.lit import Lit
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import C0, Gaussians

STEP = 4
"""Frames between two looks for things that appeared."""

ROOM = 6000
"""Newcomers a group takes, or as many as it has dynamic points: flicker and noise are no things."""


Draw = Callable[[Gaussians, Camera], np.ndarray]
"""The picture of Gaussians from a camera, [H, W, 3]."""


@dataclass(frozen=True)
class Start:
    """What the training of a group starts from. dynamic: its points at the keyframe.

    tracks: [T, N, 3] their positions at every frame, shades: [T, N, 3] what their c_base gains there, or None where nobody has looked.
    """

    dynamic: Gaussians
    tracks: np.ndarray | None = None
    shades: np.ndarray | None = None


def follow(
    dynamic: Gaussians,
    lit: Lit,
    static: Gaussians,
    cameras: list[Camera],
    frames: np.ndarray,
    gains: np.ndarray,
    flow: Flow,
    near: float,
    antialias: bool,
    progress: Progress,
) -> Start:
    """Track dynamic points through frames [T, C, H, W, 3] uint8, and add points where several views lack something.

    Points come in this order: dynamic ones, newcomers, lit ones, whose light is of the same frames. gains: [C, 3] colour gain of each
    camera. near, antialias: how pictures of the points are drawn.
    """
    resting = Gaussians.concatenate([static, lit.points])
    tracker = Tracker(resting, cameras, frames, flow, near)
    trails = [Trail(dynamic, 0)]
    draw = partial(render_image, near=near, antialias=antialias)
    known = _wrong(dynamic, resting, tracker, 0, gains, draw)
    room = max(ROOM, len(dynamic))
    for frame in range(1, len(frames)):
        tracker.forth(trails, frame - 1)
        if frame % STEP == 0:
            progress.update(frame, dynamic=sum(len(trail.points) for trail in trails))
            moved = Gaussians.concatenate([trail.here for trail in trails])
            still = Gaussians.concatenate([static, lit.at(frame)])
            newcomers, motion = _appeared(moved, still, tracker, frame, gains, known, draw)
            room -= len(newcomers)
            if len(newcomers) and room >= 0:
                trails.append(Trail(newcomers, frame, motion))
    tracker.back(trails)
    tracks = [trail.positions for trail in trails]
    starts = [
        trail.points.moved(track[0] - trail.points.means, identity(len(trail.points)))
        for trail, track in zip(trails[1:], tracks[1:], strict=True)
    ]
    points = Gaussians.concatenate([dynamic, *starts, lit.points])
    shades = np.zeros((len(frames), len(points), 3), np.float32)
    shades[:, len(points) - len(lit) :] = lit.shades
    return Start(points, np.concatenate([*tracks, lit.tracks], axis=1), shades)


def _wrong(
    moving: Gaussians, static: Gaussians, tracker: Tracker, frame: int, gains: np.ndarray, draw: Draw
) -> np.ndarray:
    """[C, H, W] bool: where the views of a frame differ from the scene as it is tracked. moving: the dynamic points there."""
    scene = Gaussians.concatenate([static, moving])
    views = zip(tracker.cameras, tracker.frames[frame], gains, strict=True)
    return np.stack([wrong_pixels(draw(scene, c) * gain, image) for c, image, gain in views])


def _appeared(
    moving: Gaussians, static: Gaussians, tracker: Tracker, frame: int, gains: np.ndarray, known: np.ndarray, draw: Draw
) -> tuple[Gaussians, np.ndarray]:
    """Gaussians, in place at a frame, of what the views show there and the scene does not, and about how they move, [N, 3].

    moving: the dynamic points there. known: [C, H, W] bool, what was wrong at the keyframe already, where the points had been
    trained: mirrors, not newcomers.
    """
    wrong = _wrong(moving, static, tracker, frame, gains, draw) & ~known
    depths, here = tracker.depths(moving), tracker.frames[frame]
    found = find(tracker.cameras, here, wrong, depths, tracker.near, seed=frame)
    way = 1 if frame + 1 < len(tracker.frames) else -1
    there = tracker.frames[frame + way]
    motion = way * leaps(found.points, found.sizes, tracker.cameras, here, there, depths, tracker.near)
    count, bands = len(found.points), moving.sh.shape[1]
    sh = np.zeros((count, bands, 3), np.float32)
    sh[:, 0] = (found.colors - 0.5) / C0
    scales = np.repeat(found.sizes[:, None], 3, 1)
    return Gaussians(found.points, identity(count), scales, np.full(count, 0.7, np.float32), sh), motion
