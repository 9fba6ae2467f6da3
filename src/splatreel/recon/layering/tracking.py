"""The start of a group: tracks of its dynamic points by flow, and new points for what appears (before any training)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from splatreel.motion.appear import Faults, faults, find
from splatreel.motion.flow import Flow
from splatreel.motion.large_displacement import leaps
from splatreel.motion.lift import shares
from splatreel.motion.track import Tracker, Trail, identity
from splatreel.progress import Progress
from splatreel.recon.layering.relighting import RelitPoints
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import C0, Gaussians

STEP = 4
"""Frames between two looks for things that appeared."""

ROOM = 6000
"""Points a group takes so, or as many as it has dynamic points: flicker and noise are no things."""

LEFT = 0.7
"""Share of what is seen of a static point, over all views, that must be wrong for it to have left its place."""
PEELS = 3
"""Times that one looks, at most: behind a thing's points are others of it, which show once those are gone."""
FEW = 20
"""Static points that leave together, at least: a speck is no thing, and to find out where things went takes flow once more."""

Draw = Callable[[Gaussians, Camera], np.ndarray]
"""The picture of Gaussians from a camera, [H, W, 3]."""


@dataclass(frozen=True)
class Start:
    """What the training of a group starts from. dynamic: its points at the keyframe.

    tracks: [T, N, 3] their positions at every frame, shades: [T, N, 3] what their c_base gains there, or None where nobody has looked.
    left: [S] bool, the static points that are among them now.
    """

    dynamic: Gaussians
    tracks: np.ndarray | None = None
    shades: np.ndarray | None = None
    left: np.ndarray | None = None


def follow(
    dynamic: Gaussians,
    motion: np.ndarray | None,
    lit: RelitPoints,
    static: Gaussians,
    cameras: list[Camera],
    frames: np.ndarray,
    gains: np.ndarray,
    flow: Flow,
    near: float,
    draw: Draw,
    progress: Progress,
) -> Start:
    """Track dynamic points through frames [T, C, H, W, 3] uint8; add what several views lack, and static points that leave.

    motion: [N, 3], about how the dynamic points move at the keyframe, if that is known. gains: [C, 3] colour gain of each camera.
    near: nothing is seen before it. draw: how pictures of the points are drawn.

    Points come in this order: dynamic ones, those that were added, lit ones, whose light is of the same frames.
    """
    tracker = Tracker(Gaussians.concatenate([static, lit.points]), cameras, frames, flow, near)
    watch = _Watch(tracker, gains, draw, dynamic, static, lit)
    trails = [Trail(dynamic, 0, motion)]
    room = max(ROOM, len(dynamic))
    for frame in range(1, len(frames)):
        tracker.forth(trails, frame - 1)
        if frame % STEP == 0:
            progress.update(frame, moving=sum(len(trail.points) for trail in trails))
            faulty = watch.faults(trails, frame)
            newcomers, leap = watch.appeared(trails, frame, faulty)
            room -= len(newcomers)
            if len(newcomers) and room >= 0:
                trails.append(Trail(newcomers, frame, leap))
                faulty = watch.faults(trails, frame)
            leave = watch.leave(trails, frame, faulty)
            if 0 < leave.sum() <= room:
                room -= leave.sum()
                trails.append(watch.depart(leave, frame))
    tracker.back(trails)
    return _start(trails, lit, ~watch.stays)


def _start(trails: list[Trail], lit: RelitPoints, left: np.ndarray) -> Start:
    """All trails from their places at the keyframe on, then what is lit."""
    tracks = [trail.positions for trail in trails]
    starts = [
        trail.points.moved(track[0] - trail.points.means, identity(len(trail.points)))
        for trail, track in zip(trails[1:], tracks[1:], strict=True)
    ]
    points = Gaussians.concatenate([trails[0].points, *starts, lit.points])
    shades = np.zeros((len(lit.light), len(points), 3), np.float32)
    shades[:, len(points) - len(lit) :] = lit.shades
    return Start(points, np.concatenate([*tracks, lit.tracks], axis=1), shades, left)


class _Watch:
    """Compares the views with the scene as it is tracked. stays: [S] bool, the static points that have not left so far."""

    def __init__(
        self, tracker: Tracker, gains: np.ndarray, draw: Draw, dynamic: Gaussians, static: Gaussians, lit: RelitPoints
    ) -> None:
        self.tracker, self.gains, self.draw, self.static, self.lit = tracker, gains, draw, static, lit
        self.stays = np.ones(len(static), bool)
        self.known = self._differs(Gaussians.concatenate([static, lit.points, dynamic]), 0).wrong
        """[C, H, W] bool: wrong already where the points were trained: mirrors, nothing new."""

    def faults(self, trails: list[Trail], frame: int, leave: np.ndarray | None = None) -> Faults:
        """[C, H, W]: where the views of a frame differ from the scene there, and were not wrong at the keyframe.

        leave: [S] bool, static points that are left out.
        """
        resting = self._resting(frame, self.stays if leave is None else self.stays & ~leave)
        found = self._differs(Gaussians.concatenate([resting, _moved(trails)]), frame)
        return Faults(found.wrong & ~self.known, found.doubtful & ~self.known)

    def appeared(self, trails: list[Trail], frame: int, faulty: Faults) -> tuple[Gaussians, np.ndarray]:
        """Gaussians, in place at a frame, of what the views show there and the scene does not, and about how they move, [N, 3]."""
        moving, tracker = _moved(trails), self.tracker
        depths, here, first = tracker.depths(moving), tracker.frames[frame], moving.means[: len(trails[0].points)]
        found = find(tracker.cameras, here, faulty, depths, tracker.near, first, seed=frame)
        way = 1 if frame + 1 < len(tracker.frames) else -1
        there = tracker.frames[frame + way]
        motion = way * leaps(found.points, found.sizes, tracker.cameras, here, there, depths, tracker.near)
        count, bands = len(found.points), moving.sh.shape[1]
        sh = np.zeros((count, bands, 3), np.float32)
        sh[:, 0] = (found.colors - 0.5) / C0
        scales = np.repeat(found.sizes[:, None], 3, 1)
        return Gaussians(found.points, identity(count), scales, np.full(count, 0.7, np.float32), sh), motion

    def leave(self, trails: list[Trail], frame: int, faulty: Faults) -> np.ndarray:
        """[S] bool: static points that are not there any more at a frame: nearly all that the views see of them is wrong.

        Masks at the keyframe miss what rests for most of the group and then leaves at once.
        """
        moving, tracker = _moved(trails), self.tracker
        leave = np.zeros(len(self.static), bool)
        for peel in range(PEELS):
            if peel:
                faulty = self.faults(trails, frame, leave)
            staying = self.stays & ~leave
            everything = Gaussians.concatenate([self._resting(frame, staying), moving])
            smaller = faulty.wrong[:, ::2, ::2]  # tells well enough
            found = shares(everything, tracker.lookouts, smaller, tracker.near)[: staying.sum()] > LEFT
            if found.sum() < FEW:
                break
            leave[staying] = found
        return leave

    def depart(self, leave: np.ndarray, frame: int) -> Trail:
        """These static points, which rested until the last look, and where they went since."""
        self.stays &= ~leave
        self.tracker.look_past(Gaussians.concatenate([self.static[self.stays], self.lit.points]))
        trail = Trail(self.static[leave], frame - STEP, rested=True)
        for before in range(frame - STEP, frame):
            self.tracker.forth([trail], before)
        return trail

    def _resting(self, frame: int, staying: np.ndarray) -> Gaussians:
        """The static points that stay, [S] bool, and what is lit, in the light of a frame."""
        return Gaussians.concatenate([self.static[staying], self.lit.at(frame)])

    def _differs(self, scene: Gaussians, frame: int) -> Faults:
        """[C, H, W]: where the views of a frame differ from a scene."""
        views = zip(self.tracker.cameras, self.tracker.frames[frame], self.gains, strict=True)
        found = [faults(self.draw(scene, c) * gain, image) for c, image, gain in views]
        return Faults(*(np.stack(masks) for masks in zip(*found, strict=True)))


def _moved(trails: list[Trail]) -> Gaussians:
    """All points where the trails have come to."""
    return Gaussians.concatenate([trail.here for trail in trails])
