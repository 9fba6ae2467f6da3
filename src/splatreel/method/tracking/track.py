"""Tracks of points: optical flow of all views, lifted to motion in space and chained from frame to frame.

The gradient of an image moves a splat about as far as the splat is large. Thrown objects move farther between two frames. Flow
covers that distance, and many views agree on one motion in space. Deformation models start from the tracks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from splatreel.base import threads
from splatreel.kernels import rigid, sceneflow, splat
from splatreel.kernels.rigid import Template, Views
from splatreel.method.images.flow import Flow, map_views
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians

SMOOTHING_ROUNDS = 3
"""Rounds of reweighting in the smoothing of neighbors' motions."""
NEIGHBORS = 16
"""Number of neighbors whose motions are averaged with a point's own."""
BLOCK = 1024
"""Points whose motions are averaged at a time."""


class PointTracks:
    """Positions of points at the frames passed so far, from frame `start` on."""

    def __init__(
        self, points: Gaussians, start: int, motion: np.ndarray | None = None, *, static_before: bool = False
    ) -> None:
        """Start tracks. `motion` [N, 3], per frame, is approximate. `static_before`: the points rested at all earlier frames."""
        self.points = points
        self.start = start
        self.neighbors = _neighbors(points.means)
        moves = np.zeros_like(points.means) if motion is None else motion
        self._later, self._earlier = ([(points.means, way * moves)] for way in (1, -1))
        self._earlier += [(points.means, moves)] * (start if static_before else 0)
        self.patches: RigidPatches | None = None  # from the first step on

    def last(self, later: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return positions and last motion [N, 3] at the frame farthest from the start, in one direction of time."""
        return (self._later if later else self._earlier)[-1]

    def append(self, later: bool, motion: np.ndarray) -> None:
        """Advance by one frame in one direction of time. motion: [N, 3]."""
        (self._later if later else self._earlier).append((self.last(later)[0] + motion, motion))

    @property
    def first(self) -> int:
        """Earliest frame passed."""
        return self.start - len(self._earlier) + 1

    @property
    def at_last_frame(self) -> Gaussians:
        """The points at the last frame passed."""
        return self.points.moved(self.last(True)[0] - self.points.means, identity_quats(len(self.points)))

    @property
    def positions(self) -> np.ndarray:
        """Positions at every frame passed, [T, N, 3], the earliest first."""
        return np.stack([place for place, _ in [*self._earlier[:0:-1], *self._later]])


class Tracker:
    """Tracker of points through a group's frames.

    All tracks advance together, so that memory holds the flow of one pair of frames only. Points that no view sees keep their
    velocity.
    """

    def __init__(self, static: Gaussians, cameras: list[Camera], frames: np.ndarray, flow: Flow, near: float) -> None:
        """Prepare tracking. `static` points may occlude tracked points."""
        self.cameras = cameras
        self.frames = frames
        self.flow = flow
        self.near = near
        self.poses = np.stack([c.viewmat for c in cameras])
        self.lenses = np.stack([c.K for c in cameras])
        # Half the size is enough for occlusion.
        self.half_cameras = [camera.resized((camera.width + 1) // 2, (camera.height + 1) // 2) for camera in cameras]
        self.set_occluders(static)

    def set_occluders(self, static: Gaussians) -> None:
        """Replace the points that may occlude tracked points."""
        self.static_depths = threads.map_parallel(
            lambda camera: _depth_and_flow(static, None, camera, self.near)[0], self.half_cameras
        )

    def step(self, tracks: list[PointTracks], frame: int) -> None:
        """Advance tracks from a frame to the next."""
        self._step(tracks, frame, frame + 1)

    def track_back(self, tracks: list[PointTracks]) -> None:
        """Extend tracks from the earliest frame that each has passed to frame 0."""
        for frame in range(max((track.first for track in tracks), default=0), 0, -1):
            self._step([track for track in tracks if track.first == frame], frame, frame - 1)

    def depths(self, points: Gaussians) -> np.ndarray:
        """Return the depths [C, H, W] of the occluders and these points in every view, infinite where there are none."""
        height, width = self.frames.shape[2:4]
        return _enlarged(self._depths_and_guesses(points, None)[0])[:, :height, :width]

    def _step(self, tracks: list[PointTracks], here: int, there: int) -> None:
        ends = [track.last(there > here) for track in tracks]
        places, before = (np.concatenate(column) for column in zip(*ends, strict=True))
        moving = replace(Gaussians.concatenate([track.points for track in tracks]), means=places)
        depths, guesses = self._depths_and_guesses(moving, before)
        rig, (height, width) = (self.poses, self.lenses), self.frames.shape[2:4]
        wanted = sceneflow.pixels_needed(places, *rig, depths, height, width, self.near)
        work = partial(self._flow_of_view, here, there, guesses, wanted)
        flows = np.stack(map_views(work, len(self.cameras), self.flow))
        now, then = self.views(here, depths), self.views(there, np.stack(self.static_depths))
        for track, (place, motion) in zip(tracks, ends, strict=True):
            agreed, certainty = sceneflow.solve(place, motion, *rig, flows, depths, self.near)
            smooth = _smooth(agreed, certainty, track.neighbors)
            track.append(there > here, self._corrected(track, place, motion, smooth, now, then))

    def _corrected(
        self,
        track: PointTracks,
        place: np.ndarray,
        before: np.ndarray,
        motion: np.ndarray,
        now: rigid.Views,
        then: rigid.Views,
    ) -> np.ndarray:
        """Return the motion [N, 3], corrected by rigid patches where flow is wrong. before: the motion that led to `place`."""
        if track.patches is None:
            track.patches = RigidPatches(place, now)
        return track.patches.motion(place, place - before, motion, now, then)

    def views(self, frame: int, depths: np.ndarray) -> rigid.Views:
        """Return the views at a frame. depths: of occluders."""
        return rigid.make_views(self.poses, self.lenses, self.frames[frame], depths, self.near)

    def _depths_and_guesses(self, points: Gaussians, motion: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Return depths [C, ceil(H / 2), ceil(W / 2)] of occluders and these points, and the flow [.., 2] of a motion [N, 3]."""

        def of_view(view: int) -> tuple[np.ndarray, np.ndarray]:
            static = self.static_depths[view]
            depth, flow = _depth_and_flow(points, motion, self.half_cameras[view], self.near)
            return np.minimum(static, depth), np.where((depth <= static)[..., None], flow, np.float32(0))

        depths, guesses = zip(*threads.map_parallel(of_view, range(len(self.cameras))), strict=True)
        return np.stack(depths), np.stack(guesses)

    def _flow_of_view(self, here: int, there: int, guesses: np.ndarray, wanted: np.ndarray, camera: int) -> np.ndarray:
        """Return the flow of a view's wanted pixels. The search starts where constant velocity would take them."""
        height, width = self.frames.shape[2:4]
        guess = 2 * _enlarged(guesses[camera][None])[0, :height, :width]
        flow = self.flow(self.frames[here, camera], self.frames[there, camera], guess, wanted[camera])
        return flow.astype(np.float16)


def identity_quats(count: int) -> np.ndarray:
    """Return identity quaternions [N, 4]."""
    quats = np.zeros((count, 4), np.float32)
    quats[:, 0] = 1
    return quats


def _neighbors(means: np.ndarray) -> np.ndarray | None:
    count = min(NEIGHBORS, len(means) - 1)
    return splat.nearest_neighbors(means, count)[0] if count > 0 else None


def _enlarged(images: np.ndarray) -> np.ndarray:
    """Double the height and width of images [C, H, W, ...]."""
    return images.repeat(2, 1).repeat(2, 2)


def _depth_and_flow(
    points: Gaussians, motion: np.ndarray | None, camera: Camera, near: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the depth [H, W] of points, and the flow [H, W, 2] of a motion [N, 3], pixels.

    Pixels that the points cover by less than half have infinite depth and zero flow.
    """
    shape, view = (points.quats, points.scales), (camera.viewmat, camera.K, camera.width, camera.height)
    here = splat.project(points.means, *shape, *view, near)
    values = np.concatenate([here.depths[:, None], np.zeros_like(here.means2d)], 1)
    if motion is not None:
        after = splat.project(points.means + motion, *shape, *view, near)
        values[:, 1:] = np.where((after.radii > 0)[:, None], after.means2d - here.means2d, np.float32(0))
    sums, alpha = splat.rasterize(here.colored(values, points.opacities), *view[2:])
    mean, shown = sums / np.maximum(alpha, 0.5)[..., None], alpha > 0.5
    depth = np.where(shown, mean[..., 0], np.float32(np.inf))
    return depth, np.where(shown[..., None], mean[..., 1:], np.float32(0))


def _smooth(motion: np.ndarray, certainty: np.ndarray, neighbors: np.ndarray | None) -> np.ndarray:
    """Return the motion shared by each point and its neighbors. At an object's edge, flow often belongs to the background."""
    if neighbors is None:
        return motion
    smooth = np.empty_like(motion)

    def fill(first: int, last: int) -> None:
        group = np.concatenate([np.arange(first, last)[:, None], neighbors[first:last]], 1)
        smooth[first:last] = _shared_motion(motion, certainty, group)

    # A fixed number of points at a time: they fit into a cache, and the result does not depend on the number of threads.
    threads.map_parallel(lambda first: fill(first, min(first + BLOCK, len(motion))), range(0, len(motion), BLOCK))
    return smooth


def _shared_motion(motion: np.ndarray, certainty: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Return the robust mean [M, 3] of the motions of groups of points. group: [M, K] indices."""
    weight, moves = certainty[group] + np.float32(1e-3), motion[group]
    center = (moves * weight[..., None]).sum(1) / weight.sum(1, keepdims=True)
    middle = (group.shape[1] - 1) // 2
    for _ in range(SMOOTHING_ROUNDS):
        distance = np.linalg.norm(moves - center[:, None], axis=2)
        spread = np.partition(distance, middle, 1)[:, middle : middle + 1] + np.float32(1e-9)
        trust = weight / (1 + (distance / spread) ** 2)
        center = (moves * trust[..., None]).sum(1) / trust.sum(1, keepdims=True)
    return center


PATCH_POINTS, PATCH_STRIDE = 24, 3
"""Number of points of a patch, and points between the centers of two patches."""
PATCH_NEIGHBORS = (1, 2, 3, 4, 6, 8, 10, 12)
"""Ranks, by distance, of the neighbors whose motions a patch tries."""
MAX_FLOW_DIFFERENCE = 0.06
"""Color difference, 0..1, above which flow is considered wrong."""
MAX_RESIDUAL = 0.85
"""A rigid motion must leave less than this share of that difference."""
COLOR_RATE = 0.2
"""Rate at which stored colors follow the observed ones where flow is right, since light changes and objects turn."""
STEPS = (1.0, 0.5, 0.25)
"""Step sizes of the search in each sweep, relative to the first ones."""


class RigidPatches:
    """Groups of neighboring points, moved as rigid bodies to where all views show their colors.

    They track small, thin or fast content, for which optical flow fails. Around a bat that swings by twice its width, a patch of
    pixels contains mostly background. A patch of points knows its earlier motion, the motion of its neighbors, and its colors in
    many views. As in PatchMatch, good motions are passed on between patches and refined by small steps, in turns.

    Source:
        Barnes et al. 2009.
    """

    def __init__(self, points: np.ndarray, views: Views) -> None:
        self.colors = rigid.sample_colors(points, views)[1]
        self.trusted = np.zeros(len(points), np.bool_)  # the flow of the last step matched the colors
        self.patches = np.zeros((0, PATCH_POINTS), np.int64)
        if len(points) > PATCH_POINTS:
            centers = points[::PATCH_STRIDE]
            self.patches = _nearest(points, centers, range(PATCH_POINTS))
            self.neighbors = _nearest(centers, centers, [rank for rank in PATCH_NEIGHBORS if rank < len(centers)])

    def motion(self, here: np.ndarray, last: np.ndarray, flow: np.ndarray, now: Views, then: Views) -> np.ndarray:
        """Return the motion [N, 3] of the points: the flow, or a rigid motion of a patch where that fits the images clearly better.

        `last` are the positions at the previous frame. `now` has the depths of everything visible, `then` those of
        points known to be there.
        """
        if not len(self.patches):
            return flow
        seen, colors = rigid.sample_colors(here, now)
        learn = seen & self.trusted[:, None]
        self.colors[learn] += COLOR_RATE * (colors[learn] - self.colors[learn])
        template = Template(seen, self.colors, then)
        costs = rigid.color_differences(here + flow, self.patches, template)
        bad = costs > MAX_FLOW_DIFFERENCE
        chosen = np.flatnonzero(bad)
        moves, found = rigid.initial_moves(here, last, here + flow, self.patches, bad, template)
        for share in STEPS:
            rigid.refine_moves(here, self.patches, chosen, self.neighbors, moves, found, share, template)
        least = np.full(len(here), np.inf, np.float32)
        np.minimum.at(least, self.patches.ravel(), np.repeat(costs, PATCH_POINTS))
        self.trusted = least <= MAX_FLOW_DIFFERENCE
        return self._best(here, flow, least, np.flatnonzero(bad & (found < MAX_RESIDUAL * costs)), moves, found)

    def _best(
        self,
        here: np.ndarray,
        flow: np.ndarray,
        least: np.ndarray,
        better: np.ndarray,
        moves: np.ndarray,
        found: np.ndarray,
    ) -> np.ndarray:
        """Return the motion [N, 3] of the best patch of every point.

        `least` [N], the smallest color difference under flow, is changed.
        """
        motion = flow.copy()
        for patch in better:
            points = self.patches[patch][found[patch] < least[self.patches[patch]]]
            motion[points] = here[points] @ moves[patch, :, :3].T + moves[patch, :, 3] - here[points]
            least[points] = found[patch]
        return motion


def _nearest(points: np.ndarray, queries: np.ndarray, ranks: Sequence[int]) -> np.ndarray:
    """Return [Q, R] int64, the points of certain ranks by distance from each query, ranks from 0."""
    return np.ascontiguousarray(splat.nearest_neighbors(points, max(ranks) + 1, queries)[0][:, list(ranks)])
