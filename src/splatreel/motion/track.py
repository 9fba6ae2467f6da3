"""Where points go: optical flow of all views, lifted to motion in space and chained from frame to frame.

Gradients of the picture carry a splat about as far as it is large; what is thrown moves farther than that between two frames. Flow
does not mind, and many views agree on one motion in space. The tracks are a start for the deformation models, nothing more.
"""

from __future__ import annotations

from functools import partial
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor

from splatreel.kernels import splat
from splatreel.kernels.cpu import sceneflow
from splatreel.motion.flow import Flow, each_view
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians

ROUNDS = 3
"""Of reweighting, when neighbours settle on one motion."""
NEIGHBOURS = 16


class Tracker:
    """Follows points through a group's frames [T, C, H, W, 3] uint8. static: what may hide them; near: near plane, world units."""

    def __init__(self, static: Gaussians, cameras: list[Camera], frames: np.ndarray, flow: Flow, near: float) -> None:
        self.cameras, self.frames, self.flow, self.near = cameras, frames, flow, near
        self.poses, self.lenses = np.stack([c.viewmat for c in cameras]), np.stack([c.K for c in cameras])
        # What hides what is told well enough at half size.
        self.lookouts = [camera.resized((camera.width + 1) // 2, (camera.height + 1) // 2) for camera in cameras]
        self.walls = [_depth(_tensors(static), camera, near) for camera in self.lookouts]
        self._fields: dict[tuple[int, int, int], np.ndarray] = {}

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
            moving = [_depth((path[-1], shape[0], shape[1], shape[2]), camera, self.near) for camera in self.lookouts]
            depths = torch.stack([torch.minimum(wall, depth) for wall, depth in zip(self.walls, moving, strict=True)])
            fields = np.stack(each_view(partial(self._field, here, there), len(self.cameras), self.flow))
            known = path[-1].numpy(), motion.numpy(), self.poses, self.lenses, fields, depths.numpy()
            agreed, certainty = sceneflow.solve(*known, self.near)
            motion = _smooth(torch.from_numpy(agreed), torch.from_numpy(certainty), neighbours)
            path.append(path[-1] + motion)
        return path

    def _field(self, here: int, there: int, camera: int) -> np.ndarray:
        key = here, there, camera
        if key not in self._fields:
            field = self.flow(self.frames[here, camera], self.frames[there, camera])
            self._fields[key] = field.astype(np.float16)
        return self._fields[key]


def _tensors(gaussians: Gaussians) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    names = ("means", "quats", "scales", "opacities")
    arrays = [torch.from_numpy(getattr(gaussians, name)) for name in names]
    return arrays[0], arrays[1], arrays[2], arrays[3]


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
