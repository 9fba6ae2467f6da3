"""Where points go: optical flow of all views, lifted to motion in space and chained from frame to frame.

Gradients of the picture carry a splat about as far as it is large; what is thrown moves farther than that between two frames. Flow
does not mind, and many views agree on one motion in space. The tracks are a start for the deformation models, nothing more.
"""

from __future__ import annotations

from functools import partial

import numpy as np
import torch
from torch import Tensor

from splatreel.kernels import splat
from splatreel.kernels.cpu import sceneflow
from splatreel.kernels.cpu.rigid import Eyes
from splatreel.motion.flow import Flow, each_view
from splatreel.motion.parts import Parts
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians

ROUNDS = 3
"""Of reweighting, when neighbours settle on one motion."""
NEIGHBOURS = 16

Splats = tuple[Tensor, Tensor, Tensor, Tensor]
"""Means, quaternions, scales and opacities."""


class Trail:
    """Points on their way: where they are at the frames passed so far. start: the frame where `points` are in place.

    motion: [N, 3], about how they move there, if that is known. rested: they were there all the time before.
    """

    def __init__(
        self, points: Gaussians, start: int, motion: np.ndarray | None = None, *, rested: bool = False
    ) -> None:
        self.points, self.start = points, start
        self.tensors = _tensors(points)
        self.neighbours = _neighbours(self.tensors[0])
        moves = torch.zeros_like(self.tensors[0]) if motion is None else torch.from_numpy(motion)
        self._forth, self._back = ([(self.tensors[0], way * moves)] for way in (1, -1))
        self._back += [(self.tensors[0], moves)] * (start if rested else 0)
        self.parts: Parts | None = None  # as soon as somebody has looked at them

    def last(self, forth: bool) -> tuple[Tensor, Tensor]:
        """Where the points are, [N, 3], and how they moved there, at the frame farthest from the start in that direction."""
        return (self._forth if forth else self._back)[-1]

    def go(self, forth: bool, motion: Tensor) -> None:
        """One frame on. motion: [N, 3]."""
        (self._forth if forth else self._back).append((self.last(forth)[0] + motion, motion))

    @property
    def first(self) -> int:
        """The earliest frame passed."""
        return self.start - len(self._back) + 1

    @property
    def here(self) -> Gaussians:
        """The points at the last frame."""
        return self.points.moved(self.last(True)[0].numpy() - self.points.means, identity(len(self.points)))

    @property
    def positions(self) -> np.ndarray:
        """[T, N, 3] at every frame passed, the earliest first."""
        return torch.stack([place for place, _ in [*self._back[:0:-1], *self._forth]]).numpy()


class Tracker:
    """Follows points through a group's frames [T, C, H, W, 3] uint8. static: what may hide them; near: near plane, world units.

    All trails take a step together: the flow of one pair of frames is in memory, not that of a group. Points that no view sees go on
    as they were going.
    """

    def __init__(self, static: Gaussians, cameras: list[Camera], frames: np.ndarray, flow: Flow, near: float) -> None:
        self.cameras, self.frames, self.flow, self.near = cameras, frames, flow, near
        self.poses, self.lenses = np.stack([c.viewmat for c in cameras]), np.stack([c.K for c in cameras])
        # What hides what is told well enough at half size.
        self.lookouts = [camera.resized((camera.width + 1) // 2, (camera.height + 1) // 2) for camera in cameras]
        self.look_past(static)

    def look_past(self, static: Gaussians) -> None:
        """From now on these are what may hide points."""
        self.walls = [_glance(_tensors(static), None, camera, self.near)[0] for camera in self.lookouts]

    def forth(self, trails: list[Trail], frame: int) -> None:
        """From a frame to the next."""
        self._step(trails, frame, frame + 1)

    def back(self, trails: list[Trail]) -> None:
        """From the earliest frame that each has passed to the first."""
        for frame in range(max((trail.first for trail in trails), default=0), 0, -1):
            self._step([trail for trail in trails if trail.first == frame], frame, frame - 1)

    def depths(self, points: Gaussians) -> np.ndarray:
        """[C, H, W] what every view sees of the static points and these, infinite for nothing."""
        height, width = self.frames.shape[2:4]
        small = self._seen(_tensors(points), None)[0]
        return _enlarged(small)[:, :height, :width].numpy()

    def _step(self, trails: list[Trail], here: int, there: int) -> None:
        ends = [trail.last(there > here) for trail in trails]
        places, before = (torch.cat(column) for column in zip(*ends, strict=True))
        quats, scales, opacities = (torch.cat([trail.tensors[k] for trail in trails]) for k in (1, 2, 3))
        depths, guesses = self._seen((places, quats, scales, opacities), before)
        rig, (height, width) = (self.poses, self.lenses), self.frames.shape[2:4]
        wanted = sceneflow.asked(places.numpy(), *rig, depths.numpy(), height, width, self.near)
        work = partial(self._field, here, there, guesses, wanted)
        fields = np.stack(each_view(work, len(self.cameras), self.flow))
        now, then = self.eyes(here, depths.numpy()), self.eyes(there, torch.stack(self.walls).numpy())
        for trail, (place, motion) in zip(trails, ends, strict=True):
            known = place.numpy(), motion.numpy(), *rig, fields, depths.numpy()
            agreed, certainty = sceneflow.solve(*known, self.near)
            smooth = _smooth(torch.from_numpy(agreed), torch.from_numpy(certainty), trail.neighbours)
            trail.go(there > here, self._settled(trail, place, motion, smooth, now, then))

    def _settled(self, trail: Trail, place: Tensor, before: Tensor, motion: Tensor, now: Eyes, then: Eyes) -> Tensor:
        """Motion [N, 3], but where flow is wrong. before: the motion to `place`."""
        if trail.parts is None:
            trail.parts = Parts(place.numpy(), now)
        last = (place - before).numpy()
        return torch.from_numpy(trail.parts.motion(place.numpy(), last, motion.numpy(), now, then))

    def eyes(self, frame: int, depths: np.ndarray) -> Eyes:
        """The views at a frame. depths: of what hides points from them."""
        finite = np.minimum(depths, np.float32(1e30))  # fast mathematics knows no infinity
        return Eyes(self.poses, self.lenses, self.frames[frame], finite, np.float32(self.near))

    def _seen(self, points: Splats, motion: Tensor | None) -> tuple[Tensor, Tensor]:
        """[C, ceil(H / 2), ceil(W / 2)] depths of the static points and these; [.., 2] where a motion [N, 3] of these takes pixels."""
        depths, ways = [], []
        for wall, camera in zip(self.walls, self.lookouts, strict=True):
            depth, way = _glance(points, motion, camera, self.near)
            depths.append(torch.minimum(wall, depth))
            ways.append(torch.where((depth <= wall)[..., None], way, 0))
        return torch.stack(depths), torch.stack(ways)

    def _field(self, here: int, there: int, guesses: Tensor, wanted: np.ndarray, camera: int) -> np.ndarray:
        """Flow of a view's wanted pixels. What moves is looked for first where it would be if it went on as it did."""
        height, width = self.frames.shape[2:4]
        guess = 2 * _enlarged(guesses[camera][None])[0, :height, :width].numpy()
        flow = self.flow(self.frames[here, camera], self.frames[there, camera], guess, wanted[camera])
        return flow.astype(np.float16)


def identity(count: int) -> np.ndarray:
    """Quaternions [N, 4] that turn nothing."""
    quats = np.zeros((count, 4), np.float32)
    quats[:, 0] = 1
    return quats


def _tensors(gaussians: Gaussians) -> Splats:
    names = ("means", "quats", "scales", "opacities")
    arrays = [torch.from_numpy(getattr(gaussians, name)) for name in names]
    return arrays[0], arrays[1], arrays[2], arrays[3]


def _neighbours(means: Tensor) -> Tensor | None:
    count = min(NEIGHBOURS, len(means) - 1)
    return splat.nearest_neighbours(means, count)[0] if count > 0 else None


def _enlarged(images: Tensor) -> Tensor:
    """Twice the height and width of images [C, H, W, ...]."""
    return images.repeat_interleave(2, 1).repeat_interleave(2, 2)


@torch.no_grad()
def _glance(points: Splats, motion: Tensor | None, camera: Camera, near: float) -> tuple[Tensor, Tensor]:
    """What a view sees of points, where they cover a pixel by more than half.

    Returns depth [H, W], infinite elsewhere, and where a motion [N, 3] takes the pixels [H, W, 2], in pixels; none elsewhere.
    """
    means, quats, scales, opacities = points
    view = camera.viewmat, camera.K, camera.width, camera.height
    p = splat.project(means, quats, scales, *view, near)
    values = torch.cat([p.depths[:, None], torch.zeros_like(p.means2d)], 1)
    if motion is not None:
        after = splat.project(means + motion, quats, scales, *view, near)
        values[:, 1:] = torch.where((after.radii > 0)[:, None], after.means2d - p.means2d, 0)
    sums, alpha = splat.rasterize(p.means2d, p.conics, values, opacities, p.depths, p.radii, *view[2:])
    mean, shown = sums / alpha.clamp_min(0.5)[..., None], alpha > 0.5
    return torch.where(shown, mean[..., 0], torch.inf), torch.where(shown[..., None], mean[..., 1:], 0)


def _smooth(motion: Tensor, certainty: Tensor, neighbours: Tensor | None) -> Tensor:
    """The motion that a point and its neighbours share: at an object's edge, flow belongs to what is behind it as often as not."""
    if neighbours is None:
        return motion
    group = torch.cat([torch.arange(len(motion))[:, None], neighbours], 1)
    weight, moves = certainty[group] + 1e-3, motion[group]
    center = (moves * weight[..., None]).sum(1) / weight.sum(1, keepdim=True)
    for _ in range(ROUNDS):
        distance = (moves - center[:, None]).norm(dim=2)
        spread = distance.median(1, keepdim=True).values + 1e-9
        trust = weight / (1 + (distance / spread) ** 2)
        center = (moves * trust[..., None]).sum(1) / trust.sum(1, keepdim=True)
    return center
