"""Where points go: optical flow of all views, lifted to motion in space and chained from frame to frame.

Gradients of the picture carry a splat about as far as it is large; what is thrown moves farther than that between two frames. Flow
does not mind, and many views agree on one motion in space. The tracks are a start for the deformation models, nothing more.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor

from splatreel.kernels import splat
from splatreel.motion.flow import Flow
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians

HIDDEN = 1.03
"""A point farther than this times the depth the view sees is behind something."""
ROUNDS = 3
TOLERANCE = 1.0
"""Pixels of disagreement at which a view's flow begins to count for less."""
NEIGHBOURS = 16


@dataclass(frozen=True)
class _Pinhole:
    rotation: Tensor
    translation: Tensor
    fx: float
    fy: float
    cx: float
    cy: float


class Tracker:
    """Follows points through a group's frames [T, C, H, W, 3] uint8. static: what may hide them; near: near plane, world units."""

    def __init__(self, static: Gaussians, cameras: list[Camera], frames: np.ndarray, flow: Flow, near: float) -> None:
        self.cameras, self.frames, self.flow, self.near = cameras, frames, flow, near
        self.pinholes = [_pinhole(camera) for camera in cameras]
        # What hides what is told well enough at half size.
        self.lookouts = [camera.resized((camera.width + 1) // 2, (camera.height + 1) // 2) for camera in cameras]
        self.walls = [_depth(_tensors(static), camera, near) for camera in self.lookouts]
        self._fields: dict[tuple[int, int, int], Tensor] = {}

    def track(self, points: Gaussians, start: int = 0) -> np.ndarray:
        """Positions [T, N, 3] at every frame of points that are in place at frame `start`.

        Points that no view sees go on as they were going.
        """
        count = len(self.frames)
        forth = self._chain(points, list(range(start, count)))
        back = self._chain(points, list(range(start, -1, -1)))
        return torch.stack([*back[:0:-1], *forth]).numpy()

    def depths(self, points: Gaussians) -> np.ndarray:
        """[C, H, W] what every view sees of the static points and these, infinite for nothing."""
        moving = [_depth(_tensors(points), camera, self.near) for camera in self.lookouts]
        small = torch.stack([torch.minimum(a, b) for a, b in zip(self.walls, moving, strict=True)])
        height, width = self.frames.shape[2:4]
        return small.repeat_interleave(2, 1).repeat_interleave(2, 2)[:, :height, :width].numpy()

    def _chain(self, points: Gaussians, order: list[int]) -> list[Tensor]:
        means, *shape = _tensors(points)
        neighbours = _neighbours(means)
        path, motion = [means], torch.zeros_like(means)
        for here, there in pairwise(order):
            views = []
            for c, (camera, pinhole, wall) in enumerate(zip(self.lookouts, self.pinholes, self.walls, strict=True)):
                depth = torch.minimum(wall, _depth((path[-1], shape[0], shape[1], shape[2]), camera, self.near))
                views.append(_observe(path[-1], pinhole, self._field(c, here, there), depth, self.near))
            motion = _smooth(*_solve(views, motion), neighbours)
            path.append(path[-1] + motion)
        return path

    def _field(self, camera: int, here: int, there: int) -> Tensor:
        key = camera, here, there
        if key not in self._fields:
            field = self.flow(self.frames[here, camera], self.frames[there, camera])
            self._fields[key] = torch.from_numpy(field.astype(np.float16))
        return self._fields[key].float()


def _tensors(gaussians: Gaussians) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    names = ("means", "quats", "scales", "opacities")
    arrays = [torch.from_numpy(getattr(gaussians, name)) for name in names]
    return arrays[0], arrays[1], arrays[2], arrays[3]


def _pinhole(camera: Camera) -> _Pinhole:
    K, pose = camera.K, torch.from_numpy(camera.viewmat)
    return _Pinhole(pose[:3, :3], pose[:3, 3], float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]))


def _neighbours(means: Tensor) -> Tensor | None:
    count = min(NEIGHBOURS, len(means) - 1)
    return splat.nearest_neighbours(means, count)[0] if count > 0 else None


@torch.no_grad()
def _depth(points: tuple[Tensor, Tensor, Tensor, Tensor], camera: Camera, near: float) -> Tensor:
    """[H, W] depth where points cover a pixel by more than half, infinite elsewhere."""
    means, quats, scales, opacities = points
    size = camera.width, camera.height
    p = splat.project(means, quats, scales, camera.viewmat, camera.K, *size, near)
    sums, alpha = splat.rasterize(p.means2d, p.conics, p.depths[:, None], opacities, p.depths, p.radii, *size)
    return torch.where(alpha > 0.5, sums[..., 0] / alpha.clamp_min(0.5), torch.inf)


@dataclass(frozen=True)
class _View:
    """What one view says of every point's motion: jacobian [N, 2, 3] pixels per world unit, flow [N, 2], weight [N] 0 or 1."""

    jacobian: Tensor
    flow: Tensor
    weight: Tensor


def _observe(means: Tensor, pinhole: _Pinhole, field: Tensor, depth: Tensor, near: float) -> _View:
    local = means @ pinhole.rotation.T + pinhole.translation
    x, y, z = local.unbind(1)
    ahead = z > near
    z = torch.where(ahead, z, torch.ones_like(z))
    u, v = pinhole.fx * x / z + pinhole.cx, pinhole.fy * y / z + pinhole.cy
    height, width = field.shape[:2]
    inside = ahead & (u >= 0) & (v >= 0) & (u < width) & (v < height)
    column, row = u.long().clamp(0, width - 1), v.long().clamp(0, height - 1)
    seen = inside & (z <= HIDDEN * depth[row // 2, column // 2])
    zero = torch.zeros_like(z)
    lens = torch.stack(
        [
            torch.stack([pinhole.fx / z, zero, -pinhole.fx * x / z**2], 1),
            torch.stack([zero, pinhole.fy / z, -pinhole.fy * y / z**2], 1),
        ],
        1,
    )
    return _View(lens @ pinhole.rotation, field[row, column], seen.float())


def _solve(views: list[_View], last: Tensor) -> tuple[Tensor, Tensor]:
    """Motion [N, 3] that the views agree on, by reweighted least squares, and how well it is held [N] (0: not at all).

    last: [N, 3] the motion before, which fills in what the views do not say.
    """
    count = len(last)
    motion = last
    certainty = torch.zeros(count)
    for turn in range(ROUNDS):
        A, b, total = torch.zeros(count, 3, 3), torch.zeros(count, 3), torch.zeros(count)
        for view in views:
            weight = view.weight
            if turn:
                error = ((view.jacobian @ motion[..., None])[..., 0] - view.flow).norm(dim=1)
                weight = weight / (1 + (error / TOLERANCE) ** 2)
            weighted = view.jacobian * weight[:, None, None]
            A += weighted.transpose(1, 2) @ view.jacobian
            b += (weighted.transpose(1, 2) @ view.flow[..., None])[..., 0]
            total += weight
        scale = A.diagonal(dim1=1, dim2=2).sum(1).clamp_min(1e-9)
        damping = (1e-3 * scale)[:, None]
        motion = torch.linalg.solve(A + damping[..., None] * torch.eye(3), b + damping * last)
        certainty = (total - 1).clamp_min(0)
    return motion, certainty


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
