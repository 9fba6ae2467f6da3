"""What a group's training gives, and how well it fits the pictures that it saw."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from splatreel.recon.cameras.time_offsets import LearnedOffsets, TimeOffsets
from splatreel.recon.train.losses import psnr
from splatreel.recon.train.moving import MovingPoints
from splatreel.recon.train.pictures import Pictures
from splatreel.recon.train.render import StaticCache, draw
from splatreel.scene.gaussians import Gaussians

SAMPLES = 12
"""Pictures that are looked at to tell how well a group fits."""


@dataclass(frozen=True)
class GroupResult:
    """dynamic: canonical points; dx: [T, N, 3], dq: [T, N, 4] at every frame; alive: [S] bool over the static points.

    shade: [T, N, 4] as in `Group`, or None. time_offsets: what the pictures tell of the cameras' clocks.
    """

    dynamic: Gaussians
    dx: np.ndarray
    dq: np.ndarray
    alive: np.ndarray
    shade: np.ndarray | None
    time_offsets: LearnedOffsets


@torch.no_grad()
def group_result(points: MovingPoints, frames: int, alive: Tensor, offsets: LearnedOffsets) -> GroupResult:
    """Points and what changes of them at every frame, as plain arrays. alive: [S] bool."""
    changes = [points.changes(frame) for frame in range(frames)]
    dx, dq = torch.stack([c.dx for c in changes]), torch.stack([c.dq for c in changes])
    logits = points.canonical.params["logit_opacities"]
    shades = [_shade(c.shade, logits) for c in changes if c.shade is not None]
    shade = torch.stack(shades).cpu().numpy() if shades else None
    arrays = dx.cpu().numpy(), dq.cpu().numpy(), alive.cpu().numpy()
    return GroupResult(points.canonical.gaussians(), *arrays, shade, offsets)


def _shade(shade: Tensor, logits: Tensor) -> Tensor:
    """[N, 4] as in `Group`: of the opacity what it gains, not what its logit does."""
    return torch.cat([shade[:, :3], ((logits + shade[:, 3]).sigmoid() - logits.sigmoid())[:, None]], 1)


@torch.no_grad()
def training_psnr(
    points: MovingPoints, static: StaticCache, pictures: Pictures, gains: Tensor, time_offsets: TimeOffsets
) -> float:
    """Mean dB over a few pictures spread over the group's frames and cameras. gains: [C, 3]."""
    values = []
    for k in range(SAMPLES):
        frame = k * (pictures.count - 1) // (SAMPLES - 1)
        camera = (k * 7) % len(pictures.views)
        view, moment = pictures.views[camera], time_offsets.moment(frame, camera, pictures.count)
        image = draw(points.at(moment, view, pictures.near), view, static.view(camera)).image
        values.append(psnr(image * gains[camera], pictures.images[frame, camera]))
    return float(np.mean(values))
