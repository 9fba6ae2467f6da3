"""Protocol of deformation models: from canonical points and a time to offsets (paper section 4.2)."""

from __future__ import annotations

from typing import Protocol

import torch
from torch import Tensor

from splatreel.method.deform.knot_adam import Restore


class Deformation(Protocol):
    """Offsets of a group's dynamic points over its frames, trained together with the points.

    A frame is a real number from 0 (the keyframe) to frames - 1. A model may start from tracks. Points that are `fixed` [N]
    bool never have offsets.
    """

    def offsets(self, means: Tensor, frame: float) -> tuple[Tensor, Tensor]:
        """Return offsets for canonical means [N, 3].

        Returns:
            dx [N, 3] in world units, and dq [N, 4], wxyz about (1, 0, 0, 0), not normalized.
        """
        ...

    def change(self, means: Tensor, span: tuple[float, float], offsets: tuple[Tensor, Tensor]) -> Tensor:
        """Return the change [] of a loss over a span of time, to first order.

        Args:
            means: [N, 3] canonical positions.
            span: First and last frame of the span.
            offsets: dx and dq that `offsets` returned, with the gradients of the loss.
        """
        ...

    def extend_to(self, frame: float) -> None:
        """Prepare for the first training on frames up to `frame`."""
        ...

    def step(self, share: float, pace: float = 1.0) -> None:
        """Take an optimizer step and clear the gradients.

        Args:
            share: Share of training that is over, 0..1.
            pace: Factor for the learning rates.
        """
        ...

    def snapshot(self) -> Restore:
        """Copy everything that training changes."""
        ...

    def check(self) -> None:
        """Check all values.

        Raises:
            GaussiansError: If a value is NaN or infinite.
        """
        ...

    def keep(self, index: Tensor) -> None:
        """Keep the rows of the points of an index [M] or mask [N]."""
        ...

    def append(self, means: Tensor, parents: Tensor | None) -> None:
        """Add points.

        Args:
            means: [M, 3] canonical positions.
            parents: [M] rows that the points copy; None for new points at rest.
        """
        ...


def movable(means: Tensor, fixed: Tensor | None) -> Tensor:
    """Return the factors [N, 1] of the offsets: 0 for points that are `fixed` [N] bool, else 1."""
    return torch.ones_like(means[:, :1]) if fixed is None else (~fixed)[:, None].to(means)


def movable_with(moves: Tensor, means: Tensor, parents: Tensor | None) -> Tensor:
    """Return the factors [M, 1] of added points: those of their parents, or 1 for new points."""
    return movable(means, None) if parents is None else moves[parents]
