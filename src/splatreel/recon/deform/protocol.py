"""The one protocol of the deformation models: canonical points and a time in, offsets out (paper section 4.2)."""

from __future__ import annotations

from typing import Protocol

import torch
from torch import Tensor

from splatreel.recon.deform.adam import Restore


class Deformation(Protocol):
    """Offsets of a group's dynamic points over its frames; trained together with the points.

    A frame is a real number from 0 (the keyframe) to frames - 1. Where tracks are known, a model is made with them and starts there;
    points that are known to rest, `fixed` [N] bool, have no offsets, now or later.
    """

    def offsets(self, means: Tensor, frame: float) -> tuple[Tensor, Tensor]:
        """dx [N, 3] in world units and dq [N, 4], wxyz about (1, 0, 0, 0), not normalized, for canonical means [N, 3]."""
        ...

    def extend_to(self, frame: float) -> None:
        """Training is about to see frames up to this one for the first time."""
        ...

    def step(self, share: float, pace: float = 1.0) -> None:
        """Take an optimizer step and clear gradients. share: 0..1, how much of training is over. pace: times the learning rates."""
        ...

    def snapshot(self) -> Restore:
        """What training changes, copied."""
        ...

    def check(self) -> None:
        """Raises `GaussiansError` if a value is NaN or infinite."""
        ...

    def keep(self, index: Tensor) -> None:
        """Keep the rows of the points that an index [M] or mask [N] selects."""
        ...

    def append(self, means: Tensor, parents: Tensor | None) -> None:
        """Points were added at means [M, 3]: copies of the rows parents [M], or new points that rest (None)."""
        ...


def movable(means: Tensor, fixed: Tensor | None) -> Tensor:
    """[N, 1] what offsets of points at means [N, 3] are multiplied by: 0 where `fixed` [N] bool says so, else 1."""
    return torch.ones_like(means[:, :1]) if fixed is None else (~fixed)[:, None].to(means)


def movable_with(moves: Tensor, means: Tensor, parents: Tensor | None) -> Tensor:
    """[M, 1] the same of points that are added at means [M, 3]: copies do as their parents, new points may move."""
    return movable(means, None) if parents is None else moves[parents]
