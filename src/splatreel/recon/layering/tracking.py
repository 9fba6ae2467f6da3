"""The start of a group: tracks of its dynamic points by flow, and new points for what appears (before any training)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splatreel.config import LayeringConfig
from splatreel.kernels.image import Backdrop
from splatreel.motion.flow import make_flow
from splatreel.motion.large_displacement import large_displacements
from splatreel.motion.lift import shares
from splatreel.motion.new_points import ErrorMasks, error_masks, find_new_points
from splatreel.motion.track import PointTracks, Tracker, identity
from splatreel.progress import Progress
from splatreel.recon.cameras.group_input import GroupInput
from splatreel.recon.layering.relighting import RelitPoints
from splatreel.scene.gaussians import C0, Gaussians
from splatreel.scene.static_points import StaticPoints

LOOK_EVERY = 4
"""Frames between two looks for things that appeared."""
MAX_NEW_POINTS = 6000
"""That a group takes so, or as many as it has dynamic points: flicker and noise are no things."""
GONE = 0.7
"""Share of what is seen of a static point, over all views, that must be wrong for it to have left its place."""
MAX_PEELS = 3
"""Times that one looks, at most: behind a thing's points are others of it, which show once those are gone."""
MIN_LEAVING = 20
"""Static points that leave together, at least: a speck is no thing, and to find out where things went takes flow once more."""


@dataclass(frozen=True)
class GroupStart:
    """What the training of a group starts from. dynamic: its points at the keyframe.

    tracks: [T, N, 3] their positions at every frame, shades: [T, N, 3] what their c_base gains there, or None where nobody has looked.
    left: [A] bool, the living static points that are among them now.
    """

    dynamic: Gaussians
    tracks: np.ndarray | None = None
    shades: np.ndarray | None = None
    left: np.ndarray | None = None


def track(
    data: GroupInput,
    dynamic: Gaussians,
    relit: RelitPoints,
    static: StaticPoints,
    velocities: np.ndarray | None,
    config: LayeringConfig,
    progress: Progress,
) -> GroupStart:
    """Track dynamic points through the frames of a group; add what several views lack, and static points that leave.

    velocities: [N, 3], about how the dynamic points move at the keyframe, world units a frame, if that is known.

    Points come in this order: dynamic ones, those that were added, relit ones, whose light is of the same frames.
    """
    data, behind = data.smaller(), Gaussians.concatenate([static.living, relit.points])
    tracker = Tracker(behind, data.cameras, data.images, make_flow(config.flow), data.near)
    detector = ChangeDetector(tracker, data, dynamic, static.living, relit)
    tracks = [PointTracks(dynamic, 0, velocities)]
    room = max(MAX_NEW_POINTS, len(dynamic))
    for frame in range(1, data.span.count):
        tracker.step(tracks, frame - 1)
        if frame % LOOK_EVERY == 0:
            progress.update(frame, moving=sum(len(track.points) for track in tracks))
            masks = detector.error_masks(tracks, frame)
            new, motion = detector.appeared(tracks, frame, masks)
            if 0 < len(new) <= room:
                room -= len(new)
                tracks.append(PointTracks(new, frame, motion))
                masks = detector.error_masks(tracks, frame)
            leaving = detector.leaving(tracks, frame, masks)
            if 0 < leaving.sum() <= room:
                room -= leaving.sum()
                tracks.append(detector.depart(leaving, frame))
    tracker.track_back(tracks)
    return _start(tracks, relit, ~detector.stays)


def _start(tracks: list[PointTracks], relit: RelitPoints, left: np.ndarray) -> GroupStart:
    """All tracks from their places at the keyframe on, then what is relit."""
    positions = [track.positions for track in tracks]
    starts = [
        track.points.moved(places[0] - track.points.means, identity(len(track.points)))
        for track, places in zip(tracks[1:], positions[1:], strict=True)
    ]
    points = Gaussians.concatenate([tracks[0].points, *starts, relit.points])
    shades = np.zeros((len(relit.light), len(points), 3), np.float32)
    shades[:, len(points) - len(relit) :] = relit.shades
    return GroupStart(points, np.concatenate([*positions, relit.tracks], axis=1), shades, left)


class ChangeDetector:
    """Compares the views with the scene as it is tracked. stays: [A] bool, the living static points that have not left so far."""

    def __init__(
        self, tracker: Tracker, data: GroupInput, dynamic: Gaussians, static: Gaussians, relit: RelitPoints
    ) -> None:
        self.tracker, self.data, self.static, self.relit = tracker, data, static, relit
        self.stays = np.ones(len(static), bool)
        self.backdrops = self._backdrops(self.stays)
        self.known = self._compare(self.backdrops, dynamic, 0).error
        """[C, H, W] bool: errors already where the points were trained: mirrors, nothing new."""

    def error_masks(self, tracks: list[PointTracks], frame: int, leaving: np.ndarray | None = None) -> ErrorMasks:
        """[C, H, W]: where the views of a frame differ from the scene there, and were not wrong at the keyframe.

        leaving: [A] bool, static points that are left out.
        """
        backdrops = self.backdrops if leaving is None else self._backdrops(self.stays & ~leaving)
        found = self._compare(backdrops, _moved(tracks), frame)
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

    def leaving(self, tracks: list[PointTracks], frame: int, masks: ErrorMasks) -> np.ndarray:
        """[A] bool: static points that are not there any more at a frame: nearly all that the views see of them is wrong.

        Masks at the keyframe miss what rests for most of the group and then leaves at once.
        """
        moving, tracker = _moved(tracks), self.tracker
        leaving = np.zeros(len(self.static), bool)
        for peel in range(MAX_PEELS):
            if peel:
                masks = self.error_masks(tracks, frame, leaving)
            staying = self.stays & ~leaving
            everything = Gaussians.concatenate([self._resting(frame, staying), moving])
            smaller = masks.error[:, ::2, ::2]  # tells well enough
            found = shares(everything, tracker.half_cameras, smaller, tracker.near)[: staying.sum()] > GONE
            if found.sum() < MIN_LEAVING:
                break
            leaving[staying] = found
        return leaving

    def depart(self, leaving: np.ndarray, frame: int) -> PointTracks:
        """These static points, which rested until the last look, and where they went since."""
        self.stays &= ~leaving
        self.backdrops = self._backdrops(self.stays)
        self.tracker.set_occluders(Gaussians.concatenate([self.static[self.stays], self.relit.points]))
        track = PointTracks(self.static[leaving], frame - LOOK_EVERY, rested=True)
        for before in range(frame - LOOK_EVERY, frame):
            self.tracker.step([track], before)
        return track

    def _resting(self, frame: int, staying: np.ndarray) -> Gaussians:
        """The static points that stay, [A] bool, and what is relit, in the light of a frame."""
        return Gaussians.concatenate([self.static[staying], self.relit.at(frame)])

    def _backdrops(self, staying: np.ndarray) -> list[Backdrop]:
        """The static points that stay, [A] bool, as each camera sees them."""
        return [self.data.backdrop(self.static[staying], camera) for camera in self.data.cameras]

    def _compare(self, backdrops: list[Backdrop], moving: Gaussians, frame: int) -> ErrorMasks:
        """[C, H, W]: where the views of a frame differ from what stays, what is relit and what moves."""
        scene = Gaussians.concatenate([self.relit.at(frame), moving])
        views = zip(backdrops, self.data.images[frame], self.data.gains, strict=True)
        found = [error_masks(backdrop.with_others(scene) * gain, image) for backdrop, image, gain in views]
        return ErrorMasks(*(np.stack(masks) for masks in zip(*found, strict=True)))


def _moved(tracks: list[PointTracks]) -> Gaussians:
    """All points where the tracks have come to."""
    return Gaussians.concatenate([track.at_last_frame for track in tracks])
