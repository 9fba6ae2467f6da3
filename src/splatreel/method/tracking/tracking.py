"""Tracking at the start of a group: motion of its dynamic points, and points for content that appears or departs.

Tracking runs before a group's motion is trained. It gives training a starting position for every dynamic point at every frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from splatreel.base import threads
from splatreel.base.progress import Progress
from splatreel.config import LayeringConfig
from splatreel.kernels import photo_consistency
from splatreel.kernels.image import Backdrop
from splatreel.method.cameras.group_input import GroupInput
from splatreel.method.images.flow import make_flow
from splatreel.method.layering.labels import RelitPoints
from splatreel.method.layering.lift import shares
from splatreel.method.tracking.new_points import ErrorMasks, error_masks, find_new_points
from splatreel.method.tracking.track import PointTracks, Tracker, identity_quats
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import C0, Gaussians, StaticPoints
from splatreel.scene.group import Group

CHECK_EVERY = 4
"""Frames between two checks for content that appeared or departed."""
MAX_NEW_POINTS = 6000
"""Maximum number of points that tracking may add to a group; more only if the group starts with more dynamic points. Larger additions
are flicker or noise."""
DEPARTED_SHARE = 0.7
"""A static point has departed if more than this share of its contribution to all views lies in wrong pixels."""
MAX_PASSES = 3
"""Maximum passes of the search for departed points. Removing front points can expose further wrong ones behind them."""
MIN_DEPARTED = 20
"""Minimum number of static points that depart together. Fewer are noise, and tracking them costs another run of optical flow."""
SAME_POINT_DISTANCE = 0.01
"""Maximum distance between matching points, as a share of the viewing distance. Keyframe training moves a point by a few
pixels."""


@dataclass(frozen=True)
class GroupStart:
    """Initial state of a group's training.

    Attributes:
        dynamic: The group's N dynamic points at the keyframe.
        tracks: [T, N, 3] positions at every frame; None if the points were not tracked.
        shades: [T, N, 3] change of c_base at every frame; None if relighting was not measured.
        departed: [A] bool, living static points that became dynamic; None if the points were not tracked.
    """

    dynamic: Gaussians
    tracks: np.ndarray | None = None
    shades: np.ndarray | None = None
    departed: np.ndarray | None = None


def track(
    data: GroupInput,
    dynamic: Gaussians,
    relit: RelitPoints,
    static: StaticPoints,
    velocities: np.ndarray | None,
    config: LayeringConfig,
    progress: Progress,
) -> GroupStart:
    """Track dynamic points through a group, and add points for content that appears or departs. The relit points come last.

    `velocities` [N, 3] are the approximate motion of the dynamic points at the keyframe, world units per frame; None if
    unknown.
    """
    data, occluders = data.smaller(), Gaussians.concatenate([static.living, relit.points])
    tracker = Tracker(occluders, data.cameras, data.images, make_flow(config.flow), data.near)
    detector = ChangeDetector(tracker, data, dynamic, static.living, relit)
    tracks = [PointTracks(dynamic, 0, velocities)]
    budget = max(MAX_NEW_POINTS, len(dynamic))
    for frame in range(1, data.span.count):
        tracker.step(tracks, frame - 1)
        if frame % CHECK_EVERY == 0:
            progress.update(frame, moving=sum(len(track.points) for track in tracks))
            masks = detector.error_masks(tracks, frame)
            new, motion = detector.find_appeared(tracks, frame, masks)
            if 0 < len(new) <= budget:
                budget -= len(new)
                tracks.append(PointTracks(new, frame, motion))
                masks = detector.error_masks(tracks, frame)
            departed = detector.find_departed(tracks, frame, masks)
            if 0 < departed.sum() <= budget:
                budget -= departed.sum()
                tracks.append(detector.track_departed(departed, frame))
    tracker.track_back(tracks)
    return _group_start(tracks, relit, ~detector.remaining)


def _group_start(tracks: list[PointTracks], relit: RelitPoints, departed: np.ndarray) -> GroupStart:
    """Return all tracked points, moved to their positions at the keyframe, followed by the relit points."""
    positions = [track.positions for track in tracks]
    starts = [
        track.points.moved(places[0] - track.points.means, identity_quats(len(track.points)))
        for track, places in zip(tracks[1:], positions[1:], strict=True)
    ]
    points = Gaussians.concatenate([tracks[0].points, *starts, relit.points])
    shades = np.zeros((len(relit.light), len(points), 3), np.float32)
    shades[:, len(points) - len(relit) :] = relit.shades
    return GroupStart(points, np.concatenate([*positions, relit.tracks], axis=1), shades, departed)


class ChangeDetector:
    """Comparison of the training views with the tracked scene.

    Attributes:
        remaining: [A] bool, living static points that have not departed.
        keyframe_errors: [C, H, W] bool, pixels that are wrong at the keyframe already, such as mirrors. They indicate no change.
    """

    def __init__(
        self, tracker: Tracker, data: GroupInput, dynamic: Gaussians, static: Gaussians, relit: RelitPoints
    ) -> None:
        self.tracker = tracker
        self.data = data
        self.static = static
        self.relit = relit
        self.remaining = np.ones(len(static), bool)
        self.backdrops = self._draw_backdrops(self.remaining)
        self.keyframe_errors = self._compare(self.backdrops, dynamic, 0).error

    def error_masks(self, tracks: list[PointTracks], frame: int, ignored: np.ndarray | None = None) -> ErrorMasks:
        """Return masks [C, H, W] of pixels that are wrong at a frame and were not at the keyframe.

        Static points `ignored` [A] are not drawn.
        """
        backdrops = self.backdrops if ignored is None else self._draw_backdrops(self.remaining & ~ignored)
        found = self._compare(backdrops, _points_at_last_frame(tracks), frame)
        return ErrorMasks(found.error & ~self.keyframe_errors, found.uncertain & ~self.keyframe_errors)

    def find_appeared(self, tracks: list[PointTracks], frame: int, masks: ErrorMasks) -> tuple[Gaussians, np.ndarray]:
        """Return new points of content that the scene lacks at a frame, and their approximate motion [M, 3] per frame."""
        moving, tracker = _points_at_last_frame(tracks), self.tracker
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
        return Gaussians(found.points, identity_quats(count), scales, np.full(count, 0.7, np.float32), sh), motion

    def find_departed(self, tracks: list[PointTracks], frame: int, masks: ErrorMasks) -> np.ndarray:
        """Return [A] bool, the static points whose pixels are nearly all wrong at a frame.

        Motion masks at the keyframe miss content that is static for most of the group and then departs suddenly.
        """
        moving, tracker = _points_at_last_frame(tracks), self.tracker
        departed = np.zeros(len(self.static), bool)
        for number in range(MAX_PASSES):
            if number:
                masks = self.error_masks(tracks, frame, departed)
            remaining = self.remaining & ~departed
            everything = Gaussians.concatenate([self.static[remaining], self.relit.at(frame), moving])
            half_size = masks.error[:, ::2, ::2]  # half the resolution is enough for shares
            found = (
                shares(everything, tracker.half_cameras, half_size, tracker.near)[: remaining.sum()] > DEPARTED_SHARE
            )
            if found.sum() < MIN_DEPARTED:
                break
            departed[remaining] = found
        return departed

    def track_departed(self, departed: np.ndarray, frame: int) -> PointTracks:
        """Move static points to a new track, and track them from the last check up to a frame."""
        self.remaining &= ~departed
        self.backdrops = self._draw_backdrops(self.remaining)
        self.tracker.set_occluders(Gaussians.concatenate([self.static[self.remaining], self.relit.points]))
        track = PointTracks(self.static[departed], frame - CHECK_EVERY, static_before=True)
        for before in range(frame - CHECK_EVERY, frame):
            self.tracker.step([track], before)
        return track

    def _draw_backdrops(self, drawn: np.ndarray) -> list[Backdrop]:
        """Draw the static points of a mask [A] bool for every camera."""
        static = self.static[drawn]
        return threads.map_parallel(lambda camera: self.data.backdrop(static, camera), self.data.cameras)

    def _compare(self, backdrops: list[Backdrop], moving: Gaussians, frame: int) -> ErrorMasks:
        """Return masks [C, H, W] of the pixels in which the views of a frame differ from the scene. Missing images are right."""
        scene = Gaussians.concatenate([self.relit.at(frame), moving])

        def of_view(view: int) -> ErrorMasks:
            drawn = backdrops[view].with_others(scene) * self.data.gains[view]
            return error_masks(drawn, self.data.images[frame, view])

        found = threads.map_parallel(of_view, range(len(backdrops)))
        masks = ErrorMasks(*(np.stack(masks) for masks in zip(*found, strict=True)))
        if self.data.missing is not None:
            masks.error[self.data.missing[frame]] = masks.uncertain[self.data.missing[frame]] = False
        return masks


def _points_at_last_frame(tracks: list[PointTracks]) -> Gaussians:
    """Return the points of all tracks, at the last frame that was tracked."""
    return Gaussians.concatenate([track.at_last_frame for track in tracks])


@dataclass(frozen=True)
class VelocityPrior:
    """Velocities that one group passes to the next: `motions` [N, 3] per frame at `places` [N, 3] of the next keyframe."""

    places: np.ndarray
    motions: np.ndarray

    @classmethod
    def of(cls, group: Group, frame: int) -> VelocityPrior:
        """Compute the velocities of a group's dynamic points at a frame from the frame before."""
        here = group.at(frame).means
        return cls(here, here - group.at(frame - 1).means)

    def at(self, places: np.ndarray, unit: float) -> np.ndarray:
        """Return the velocity [M, 3] float32 of the nearest known point; zero if that point is too far away."""
        motions = np.zeros((len(places), 3), np.float32)
        if len(self.places) and len(places):
            distances, nearest = (np.asarray(column) for column in KDTree(self.places).query(places))
            near = distances < SAME_POINT_DISTANCE * unit
            motions[near] = self.motions[nearest[near]]
        return motions


LINK_DISTANCE = 3.0
"""Points closer than this multiple of their size belong to one object."""
MIN_POINTS = 8
"""Minimum number of points of an object."""
MAX_SAMPLES = 64
"""Maximum number of points that are compared per object."""
REACH, STEPS = 3.0, 4
"""Range of the search, in multiples of the object's size (mean distance of its points from their center), and steps per range."""
ROUNDS = 3
"""Rounds in which the step is halved around the best place."""
MAX_RESIDUAL = 0.6
"""A shift must leave less than this share of the color difference without motion."""


def large_displacements(
    points: np.ndarray,
    sizes: np.ndarray,
    cameras: list[Camera],
    here: np.ndarray,
    there: np.ndarray,
    depths: np.ndarray,
    near: float,
) -> np.ndarray:
    """Return the motions [N, 3] float32 of new points between two moments; zero where no motion explains the images clearly better.

    Optical flow misses fast, small content unless it starts from a guess. Each object, a connected cluster of points, is shifted
    as a whole to places around it, up to three times its size away. The shift for which all views show the same colors is its
    motion. `depths` [C, H, W] are of occluders at the first moment.
    """
    motions = np.zeros(points.shape, np.float32)
    views = np.stack([c.viewmat for c in cameras]), np.stack([c.K for c in cameras]), here, there, depths, near
    for members in _objects(points, sizes):
        chosen = points[members]
        size = float(np.linalg.norm(chosen - chosen.mean(0), axis=1).mean())
        motions[members] = _displacement(chosen[:: -(-len(chosen) // MAX_SAMPLES)], size, views)
    return motions


def _objects(points: np.ndarray, sizes: np.ndarray) -> list[np.ndarray]:
    """Return the indices of the points of each object: connected components of close points."""
    if len(points) < MIN_POINTS:
        return []
    near = KDTree(points).sparse_distance_matrix(KDTree(points), LINK_DISTANCE * float(np.median(sizes)))
    _, labels = connected_components(near, directed=False)
    return [np.flatnonzero(labels == label) for label in np.flatnonzero(np.bincount(labels) >= MIN_POINTS)]


def _displacement(points: np.ndarray, size: float, views: tuple) -> np.ndarray:
    """Return the motion [3] of one object. views: the last arguments of `photo_consistency.color_differences`."""
    grid = np.array(list(product(range(-STEPS, STEPS + 1), repeat=3)), np.float32)
    none = best = np.zeros(3, np.float32)
    step = REACH * size / STEPS
    for _ in range(ROUNDS + 1):
        tried = best + step * grid
        best = tried[photo_consistency.color_differences(points, tried, *views).argmin()]
        grid, step = grid[np.abs(grid).max(1) <= 1], step / 2
    unmoved, moved = photo_consistency.color_differences(points, np.stack([none, best]), *views)
    return best if moved < MAX_RESIDUAL * unmoved else none
