"""The one protocol of the deformation models: canonical points and a time in, offsets out (paper section 4.2)."""

from __future__ import annotations

from typing import Protocol

import torch
from torch import Tensor


class Deformation(Protocol):
    """Offsets of a group's dynamic points over its frames; trained together with the points.

    A frame is a real number from 0 (the keyframe) to frames - 1.
    """

    def offsets(self, means: Tensor, frame: float) -> tuple[Tensor, Tensor]:
        """dx [N, 3] in world units and dq [N, 4], wxyz about (1, 0, 0, 0), not normalised, for canonical means [N, 3]."""
        ...

    def follow(self, means: Tensor, positions: Tensor) -> None:
        """Start from tracks: positions [T, N, 3] of the points with canonical means [N, 3] at every frame."""
        ...

    def reach(self, frame: float) -> None:
        """Training is about to see frames up to this one for the first time."""
        ...

    def step(self, share: float) -> None:
        """Take an optimiser step and clear gradients. share: 0..1, how much of training is over."""
        ...

    def keep(self, index: Tensor) -> None:
        """Keep the rows of the points that an index [M] or mask [N] selects."""
        ...

    def append(self, means: Tensor, parents: Tensor | None) -> None:
        """Points were added at means [M, 3]: copies of the rows parents [M], or newcomers that rest (None)."""
        ...


def deform(means: Tensor, quats: Tensor, dx: Tensor, dq: Tensor) -> tuple[Tensor, Tensor]:
    """x + dx and q * dq (paper 4.2). means, dx: [N, 3]; quats, dq: [N, 4]."""
    return means + dx, multiply(quats, torch.nn.functional.normalize(dq, dim=-1))


def multiply(a: Tensor, b: Tensor) -> Tensor:
    """Hamilton product of quaternions [N, 4], wxyz."""
    aw, av = a[:, :1], a[:, 1:]
    bw, bv = b[:, :1], b[:, 1:]
    w = aw * bw - (av * bv).sum(-1, keepdim=True)
    return torch.cat([w, aw * bv + bw * av + torch.linalg.cross(av, bv)], -1)
