"""Protocol of deformation models: from canonical points and a time to offsets (paper section 4.2)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, Protocol, TypeAlias

import numpy as np

from splatreel.kernels.adam import Step
from splatreel.method.deform.knot_adam import Restore

Slope: TypeAlias = Any
"""Gradient of a loss to a model, of a type of the model."""


class Deformation(Protocol):
    """Offsets of a group's dynamic points over its frames, trained together with the points.

    A frame is a real number from 0 (the keyframe) to frames - 1. A model may start from tracks. Points that are `fixed` [N]
    bool never have offsets.
    """

    def prepare(self, times: Iterable[float]) -> None:
        """Take the optimizer steps that offsets at some times wait for.

        `offsets`, `gradient` and `change` of these times then only read the model, so that threads can share it.
        """
        ...

    def extend_to(self, frame: float) -> None:
        """Prepare for the first training on frames up to `frame`."""
        ...

    def offsets(self, means: np.ndarray, frame: float) -> tuple[np.ndarray, np.ndarray]:
        """Return dx [N, 3], world units, and dq [N, 4], wxyz about (1, 0, 0, 0), not normalized, for canonical means [N, 3]."""
        ...

    def gradient(
        self, means: np.ndarray, moments: Sequence[tuple[float, float]], d_dx: np.ndarray, d_dq: np.ndarray
    ) -> list[Slope]:
        """Return the gradient of a loss to the model. The canonical means [N, 3] get none.

        `moments` are factors and times: the gradient to the offsets at each time is that factor times d_dx [N, 3] and
        d_dq [N, 4].
        """
        ...

    def change(self, means: np.ndarray, span: tuple[float, float], slopes: Sequence[Slope]) -> float:
        """Return the change of a loss over a span of time, to first order.

        `slopes` are its gradient at one moment, with a factor of 1.
        """
        ...

    def steps(self, slopes: Sequence[Slope], share: float, pace: float) -> list[Step]:
        """Return the optimizer steps that follow a sum of results of `gradient`.

        `share` of training is over; `pace` scales the rates.
        """
        ...

    def snapshot(self) -> Restore:
        """Copy everything that training changes."""
        ...

    def check(self) -> None:
        """Raise a `GaussiansError` if a value is NaN or infinite."""
        ...

    def keep(self, index: np.ndarray) -> None:
        """Keep the rows of the points of an index [M] or mask [N]."""
        ...

    def append(self, means: np.ndarray, parents: np.ndarray | None) -> None:
        """Add points at canonical means [M, 3]: copies of the rows `parents` [M], or at rest without them."""
        ...


def movable(means: np.ndarray, fixed: np.ndarray | None) -> np.ndarray:
    """Return the factors [N, 1] of the offsets: 0 for points that are `fixed` [N] bool, else 1."""
    return np.ones((len(means), 1), np.float32) if fixed is None else (~fixed)[:, None].astype(np.float32)


def movable_with(moves: np.ndarray, means: np.ndarray, parents: np.ndarray | None) -> np.ndarray:
    """Return the factors [M, 1] of added points: those of their parents, or 1 for new points."""
    return movable(means, None) if parents is None else moves[parents]
