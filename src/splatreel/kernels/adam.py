"""Adam for many tensors at once."""

from __future__ import annotations

from collections.abc import Sequence

from splatreel.kernels.backends import backend_of
from splatreel.kernels.twin import Missed, Step, Trained

__all__ = ["Missed", "Step", "Trained", "adam", "catch_up"]


def adam(steps: Sequence[Step]) -> None:
    """Take one step of Adam for each tensor, in place. All tensors must be on one device."""
    if steps:
        backend_of(steps[0].gradient).adam(steps)


def catch_up(missed: Missed) -> None:
    """Take steps without gradient that rows have missed, in place and at once."""
    backend_of(missed.trained.parameter).catch_up(missed)
