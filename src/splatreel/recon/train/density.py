"""What the density control of keyframes and of groups is made of (3DGS): how images pull at points, and what follows from it."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from splatreel.recon.train.points import TrainablePoints

CULL_OPACITY = 0.05
"""Points fainter than this are removed (the paper's section 5.1): they hardly show and cost bytes and time."""
GROWTH_GRADIENT = 2e-4
"""Points that images pull at by more than this, in normalized device units, are densified: the number of 3DGS. Lower makes more."""
LARGEST = 0.5
"""Largest scale that a point may have, in typical viewing distances, times as much as it is farther away."""


class GradientMeter:
    """Mean length of the screen-space positional gradient of every point, in normalized device units, over its views."""

    def __init__(self, count: int, device: torch.device) -> None:
        self.sum = torch.zeros(count, device=device)
        self.seen = torch.zeros(count, device=device)

    def add(self, grad: Tensor, width: int, height: int, index: Tensor | None = None) -> None:
        """grad: [M, 2] dL/d(pixels) of all points, or of the points that index [M] names."""
        length = torch.hypot(grad[:, 0] * (width / 2), grad[:, 1] * (height / 2))
        if index is None:
            self.sum += length
            self.seen += length > 0
        else:
            self.sum.index_add_(0, index, length)
            self.seen.index_add_(0, index, (length > 0).float())

    def mean(self) -> Tensor:
        return self.sum / self.seen.clamp_min(1)


def select_growth(meter: GradientMeter, threshold: float, budget: int) -> Tensor:
    """Mask of the points to densify: gradient above threshold, the `budget` strongest at most."""
    gradient = meter.mean()
    grow = gradient > threshold
    if int(grow.sum()) > budget:
        if budget <= 0:
            return torch.zeros_like(grow)
        cut = torch.topk(gradient, budget).values[-1]
        grow &= gradient >= cut
    return grow


def too_large(scales: Tensor, distances: Tensor, unit: float) -> Tensor:
    """Mask [N] of points absurdly large for where they are. scales: [N, 3]. distances, unit: see `relative_distances`."""
    return scales.amax(1) > LARGEST * unit * distances


def children(points: TrainablePoints, split: Tensor, generator: torch.Generator) -> dict[str, Tensor]:
    """Two children for every split point, drawn from the parent's Gaussian, 1.6 times smaller (3DGS section 5.2)."""
    rows = points.rows(split)
    twice = {name: torch.cat([value, value]) for name, value in rows.items()}
    noise = torch.randn(twice["means"].shape, generator=generator).to(twice["means"].device)
    offset = noise * twice["log_scales"].exp()
    twice["means"] = twice["means"] + rotate(torch.nn.functional.normalize(twice["quats"], dim=-1), offset)
    twice["log_scales"] = twice["log_scales"] - math.log(1.6)
    return twice


def rotate(quats: Tensor, vectors: Tensor) -> Tensor:
    """Vectors [N, 3] rotated by unit quaternions [N, 4]."""
    w, xyz = quats[:, :1], quats[:, 1:]
    cross = 2 * torch.linalg.cross(xyz, vectors)
    return vectors + w * cross + torch.linalg.cross(xyz, cross)
