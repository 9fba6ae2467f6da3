"""Tracks of points: optical flow of all views, lifted to motion in space and chained from frame to frame.

The gradient of an image moves a splat about as far as the splat is large. Thrown objects move farther between two frames. Flow
covers that distance, and many views agree on one motion in space. Deformation models start from the tracks.
"""

from __future__ import annotations

from functools import partial

import numpy as np
import torch
from torch import Tensor

from splatreel.kernels import rigid, sceneflow, splat
from splatreel.method.images.flow import Flow, map_views
from splatreel.method.layering.lift import SplatTensors
from splatreel.method.tracking.rigid_patches import RigidPatches
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians

SMOOTHING_ROUNDS = 3
"""Rounds of reweighting in the smoothing of neighbors' motions."""
NEIGHBORS = 16
"""Number of neighbors whose motions are averaged with a point's own."""


class PointTracks:
    """Positions of points at the frames passed so far.

    Attributes:
        points: The points at frame `start`.
        start: Frame at which the points are in place.
    """

    def __init__(
        self, points: Gaussians, start: int, motion: np.ndarray | None = None, *, static_before: bool = False
    ) -> None:
        """Start tracks.

        Args:
            points: The points at frame `start`.
            start: Frame at which the points are in place.
            motion: [N, 3] approximate motion at `start`, world units per frame; None if unknown.
            static_before: The points had the same positions at all earlier frames.
        """
        self.points = points
        self.start = start
        self.tensors = SplatTensors.of(points)
        self.neighbors = _neighbors(self.tensors[0])
        moves = torch.zeros_like(self.tensors[0]) if motion is None else torch.from_numpy(motion)
        self._later, self._earlier = ([(self.tensors[0], way * moves)] for way in (1, -1))
        self._earlier += [(self.tensors[0], moves)] * (start if static_before else 0)
        self.patches: RigidPatches | None = None  # from the first step on

    def last(self, later: bool) -> tuple[Tensor, Tensor]:
        """Return positions and last motion [N, 3] at the frame farthest from the start, in one direction of time."""
        return (self._later if later else self._earlier)[-1]

    def append(self, later: bool, motion: Tensor) -> None:
        """Advance by one frame in one direction of time. motion: [N, 3]."""
        (self._later if later else self._earlier).append((self.last(later)[0] + motion, motion))

    @property
    def first(self) -> int:
        """Earliest frame passed."""
        return self.start - len(self._earlier) + 1

    @property
    def at_last_frame(self) -> Gaussians:
        """The points at the last frame passed."""
        return self.points.moved(self.last(True)[0].numpy() - self.points.means, identity_quats(len(self.points)))

    @property
    def positions(self) -> np.ndarray:
        """Positions at every frame passed, [T, N, 3], the earliest first."""
        return torch.stack([place for place, _ in [*self._earlier[:0:-1], *self._later]]).numpy()


class Tracker:
    """Tracker of points through a group's frames.

    All tracks advance together, so that memory holds the flow of one pair of frames only. Points that no view sees keep their
    velocity.
    """

    def __init__(self, static: Gaussians, cameras: list[Camera], frames: np.ndarray, flow: Flow, near: float) -> None:
        """Prepare tracking.

        Args:
            static: Points that may occlude tracked points.
            cameras: Training cameras.
            frames: [T, C, H, W, 3] uint8.
            flow: Optical flow.
            near: Near plane, world units.
        """
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
        self.static_depths = [
            _depth_and_flow(SplatTensors.of(static), None, camera, self.near)[0] for camera in self.half_cameras
        ]

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
        small = self._depths_and_guesses(SplatTensors.of(points), None)[0]
        return _enlarged(small)[:, :height, :width].numpy()

    def _step(self, tracks: list[PointTracks], here: int, there: int) -> None:
        ends = [track.last(there > here) for track in tracks]
        places, before = (torch.cat(column) for column in zip(*ends, strict=True))
        quats, scales, opacities = (torch.cat([track.tensors[k] for track in tracks]) for k in (1, 2, 3))
        splats = SplatTensors(places, quats, scales, opacities)
        depths, guesses = self._depths_and_guesses(splats, before)
        rig, (height, width) = (self.poses, self.lenses), self.frames.shape[2:4]
        wanted = sceneflow.pixels_needed(places.numpy(), *rig, depths.numpy(), height, width, self.near)
        work = partial(self._flow_of_view, here, there, guesses, wanted)
        flows = np.stack(map_views(work, len(self.cameras), self.flow))
        now, then = self.views(here, depths.numpy()), self.views(there, torch.stack(self.static_depths).numpy())
        for track, (place, motion) in zip(tracks, ends, strict=True):
            known = place.numpy(), motion.numpy(), *rig, flows, depths.numpy()
            agreed, certainty = sceneflow.solve(*known, self.near)
            smooth = _smooth(torch.from_numpy(agreed), torch.from_numpy(certainty), track.neighbors)
            track.append(there > here, self._corrected(track, place, motion, smooth, now, then))

    def _corrected(
        self, track: PointTracks, place: Tensor, before: Tensor, motion: Tensor, now: rigid.Views, then: rigid.Views
    ) -> Tensor:
        """Return the motion [N, 3], corrected by rigid patches where flow is wrong. before: the motion that led to `place`."""
        if track.patches is None:
            track.patches = RigidPatches(place.numpy(), now)
        last = (place - before).numpy()
        return torch.from_numpy(track.patches.motion(place.numpy(), last, motion.numpy(), now, then))

    def views(self, frame: int, depths: np.ndarray) -> rigid.Views:
        """Return the views at a frame. depths: of occluders."""
        return rigid.make_views(self.poses, self.lenses, self.frames[frame], depths, self.near)

    def _depths_and_guesses(self, points: SplatTensors, motion: Tensor | None) -> tuple[Tensor, Tensor]:
        """Return depths [C, ceil(H / 2), ceil(W / 2)] of occluders and these points, and the flow [.., 2] of a motion [N, 3]."""
        depths, guesses = [], []
        for static, camera in zip(self.static_depths, self.half_cameras, strict=True):
            depth, flow = _depth_and_flow(points, motion, camera, self.near)
            depths.append(torch.minimum(static, depth))
            guesses.append(torch.where((depth <= static)[..., None], flow, 0))
        return torch.stack(depths), torch.stack(guesses)

    def _flow_of_view(self, here: int, there: int, guesses: Tensor, wanted: np.ndarray, camera: int) -> np.ndarray:
        """Return the flow of a view's wanted pixels. The search starts where constant velocity would take them."""
        height, width = self.frames.shape[2:4]
        guess = 2 * _enlarged(guesses[camera][None])[0, :height, :width].numpy()
        flow = self.flow(self.frames[here, camera], self.frames[there, camera], guess, wanted[camera])
        return flow.astype(np.float16)


def identity_quats(count: int) -> np.ndarray:
    """Return identity quaternions [N, 4]."""
    quats = np.zeros((count, 4), np.float32)
    quats[:, 0] = 1
    return quats


def _neighbors(means: Tensor) -> Tensor | None:
    count = min(NEIGHBORS, len(means) - 1)
    return splat.nearest_neighbors(means, count)[0] if count > 0 else None


def _enlarged(images: Tensor) -> Tensor:
    """Double the height and width of images [C, H, W, ...]."""
    return images.repeat_interleave(2, 1).repeat_interleave(2, 2)


@torch.no_grad()
def _depth_and_flow(points: SplatTensors, motion: Tensor | None, camera: Camera, near: float) -> tuple[Tensor, Tensor]:
    """Return the depth [H, W] of points, and the flow [H, W, 2] of a motion [N, 3], pixels.

    Pixels that the points cover by less than half have infinite depth and zero flow.
    """
    means, quats, scales, opacities = points
    view = camera.viewmat, camera.K, camera.width, camera.height
    p = splat.project(means, quats, scales, *view, near)
    values = torch.cat([p.depths[:, None], torch.zeros_like(p.means2d)], 1)
    if motion is not None:
        after = splat.project(means + motion, quats, scales, *view, near)
        values[:, 1:] = torch.where((after.radii > 0)[:, None], after.means2d - p.means2d, 0)
    sums, alpha = splat.rasterize(p.colored(values, opacities), *view[2:])
    mean, shown = sums / alpha.clamp_min(0.5)[..., None], alpha > 0.5
    return torch.where(shown, mean[..., 0], torch.inf), torch.where(shown[..., None], mean[..., 1:], 0)


def _smooth(motion: Tensor, certainty: Tensor, neighbors: Tensor | None) -> Tensor:
    """Return the motion shared by each point and its neighbors. At an object's edge, flow often belongs to the background."""
    if neighbors is None:
        return motion
    group = torch.cat([torch.arange(len(motion))[:, None], neighbors], 1)
    weight, moves = certainty[group] + 1e-3, motion[group]
    center = (moves * weight[..., None]).sum(1) / weight.sum(1, keepdim=True)
    for _ in range(SMOOTHING_ROUNDS):
        distance = (moves - center[:, None]).norm(dim=2)
        spread = distance.median(1, keepdim=True).values + 1e-9
        trust = weight / (1 + (distance / spread) ** 2)
        center = (moves * trust[..., None]).sum(1) / trust.sum(1, keepdim=True)
    return center
