"""The start of a group: tracks of its dynamic points by flow, and new points for what appears (before any training)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from splatreel.motion.flow import Flow
from splatreel.motion.large_displacement import large_displacements
from splatreel.motion.lift import shares
from splatreel.motion.new_points import ErrorMasks, error_masks, find_new_points
from splatreel.motion.track import PointTracks, Tracker, identity
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
    detector = ChangeDetector(tracker, gains, draw, dynamic, static, lit)
    tracks = [PointTracks(dynamic, 0, motion)]
    room = max(ROOM, len(dynamic))
    for frame in range(1, len(frames)):
        tracker.step(tracks, frame - 1)
        if frame % STEP == 0:
            progress.update(frame, moving=sum(len(track.points) for track in tracks))
            masks = detector.error_masks(tracks, frame)
            new, motion = detector.appeared(tracks, frame, masks)
            room -= len(new)
            if len(new) and room >= 0:
                tracks.append(PointTracks(new, frame, motion))
                masks = detector.error_masks(tracks, frame)
            leave = detector.leave(tracks, frame, masks)
            if 0 < leave.sum() <= room:
                room -= leave.sum()
                tracks.append(detector.depart(leave, frame))
    tracker.track_back(tracks)
    return _start(tracks, lit, ~detector.stays)


def _start(tracks: list[PointTracks], lit: RelitPoints, left: np.ndarray) -> Start:
    """All tracks from their places at the keyframe on, then what is lit."""
    positions = [track.positions for track in tracks]
    starts = [
        track.points.moved(places[0] - track.points.means, identity(len(track.points)))
        for track, places in zip(tracks[1:], positions[1:], strict=True)
    ]
    points = Gaussians.concatenate([tracks[0].points, *starts, lit.points])
    shades = np.zeros((len(lit.light), len(points), 3), np.float32)
    shades[:, len(points) - len(lit) :] = lit.shades
    return Start(points, np.concatenate([*positions, lit.tracks], axis=1), shades, left)


class ChangeDetector:
    """Compares the views with the scene as it is tracked. stays: [S] bool, the static points that have not left so far."""

    def __init__(
        self, tracker: Tracker, gains: np.ndarray, draw: Draw, dynamic: Gaussians, static: Gaussians, lit: RelitPoints
    ) -> None:
        self.tracker, self.gains, self.draw, self.static, self.lit = tracker, gains, draw, static, lit
        self.stays = np.ones(len(static), bool)
        self.known = self._compare(Gaussians.concatenate([static, lit.points, dynamic]), 0).error
        """[C, H, W] bool: errors already where the points were trained: mirrors, nothing new."""

    def error_masks(self, tracks: list[PointTracks], frame: int, leave: np.ndarray | None = None) -> ErrorMasks:
        """[C, H, W]: where the views of a frame differ from the scene there, and were not wrong at the keyframe.

        leave: [S] bool, static points that are left out.
        """
        resting = self._resting(frame, self.stays if leave is None else self.stays & ~leave)
        found = self._compare(Gaussians.concatenate([resting, _moved(tracks)]), frame)
        return ErrorMasks(found.error & ~self.known, found.uncertain & ~self.known)

    def appeared(self, tracks: list[PointTracks], frame: int, masks: ErrorMasks) -> tuple[Gaussians, np.ndarray]:
        """Gaussians, in place at a frame, of what the views show there and the scene does not, and about how they move, [N, 3]."""
        moving, tracker = _moved(tracks), self.tracker
        depths, here, first = tracker.depths(moving), tracker.frames[frame], moving.means[: len(tracks[0].points)]
        found = find_new_points(tracker.cameras, here, masks, depths, tracker.near, first, seed=frame)
        way = 1 if frame + 1 < len(tracker.frames) else -1
        there = tracker.frames[frame + way]
        motion = way * large_displacements(
            found.points, found.sizes, tracker.cameras, here, there, depths, tracker.near
        )
        count, bands = len(found.points), moving.sh.shape[1]
        sh = np.zeros((count, bands, 3), np.float32)
        sh[:, 0] = (found.colors - 0.5) / C0
        scales = np.repeat(found.sizes[:, None], 3, 1)
        return Gaussians(found.points, identity(count), scales, np.full(count, 0.7, np.float32), sh), motion

    def leave(self, tracks: list[PointTracks], frame: int, masks: ErrorMasks) -> np.ndarray:
        """[S] bool: static points that are not there any more at a frame: nearly all that the views see of them is wrong.

        Masks at the keyframe miss what rests for most of the group and then leaves at once.
        """
        moving, tracker = _moved(tracks), self.tracker
        leave = np.zeros(len(self.static), bool)
        for peel in range(PEELS):
            if peel:
                masks = self.error_masks(tracks, frame, leave)
            staying = self.stays & ~leave
            everything = Gaussians.concatenate([self._resting(frame, staying), moving])
            smaller = masks.error[:, ::2, ::2]  # tells well enough
            found = shares(everything, tracker.half_cameras, smaller, tracker.near)[: staying.sum()] > LEFT
            if found.sum() < FEW:
                break
            leave[staying] = found
        return leave

    def depart(self, leave: np.ndarray, frame: int) -> PointTracks:
        """These static points, which rested until the last look, and where they went since."""
        self.stays &= ~leave
        self.tracker.set_occluders(Gaussians.concatenate([self.static[self.stays], self.lit.points]))
        track = PointTracks(self.static[leave], frame - STEP, rested=True)
        for before in range(frame - STEP, frame):
            self.tracker.step([track], before)
        return track

    def _resting(self, frame: int, staying: np.ndarray) -> Gaussians:
        """The static points that stay, [S] bool, and what is lit, in the light of a frame."""
        return Gaussians.concatenate([self.static[staying], self.lit.at(frame)])

    def _compare(self, scene: Gaussians, frame: int) -> ErrorMasks:
        """[C, H, W]: where the views of a frame differ from a scene."""
        views = zip(self.tracker.cameras, self.tracker.frames[frame], self.gains, strict=True)
        found = [error_masks(self.draw(scene, c) * gain, image) for c, image, gain in views]
        return ErrorMasks(*(np.stack(masks) for masks in zip(*found, strict=True)))


def _moved(tracks: list[PointTracks]) -> Gaussians:
    """All points where the tracks have come to."""
    return Gaussians.concatenate([track.at_last_frame for track in tracks])
