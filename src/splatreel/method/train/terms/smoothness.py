"""Smoothness of motion in time (paper section 4.2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from splatreel.kernels.adam import add_signs
from splatreel.method.train.terms.term import GroupIteration, Term

TEMPORAL_WINDOW = 2
"""Frames over which motion should be smooth; the paper's value (section 5.1)."""


@dataclass(frozen=True)
class Smoothness(Term[GroupIteration]):
    """L_temp, mean over points: between two close frames, offsets are linear in time.

        mean over points of  |(1 - b) dx(t0) + b dx(t1) - dx(t)| / unit  +  the same of dq

    with t = t0 + b (t1 - t0). The last term of the printed formula mixes an offset with a position. It is read as the offset at t.
    The gradient at each of the three moments is a multiple of one gradient.

    Source:
        Section 4.2 of the paper.
    """

    wgsl: ClassVar[tuple[str, ...]] = ("smoothness",)

    def value(self, seen: GroupIteration) -> float:
        """See `Term`."""
        if seen.span is None:
            return 0.0
        bent, turned = _deviations(seen)
        return float((np.abs(bent).sum(1) / seen.unit + np.abs(turned).sum(1)).mean())

    def add_to_points(self, seen: GroupIteration, weight: float) -> None:
        """See `Term`."""
        if seen.span is None:
            return
        bent, turned = _deviations(seen)
        share = weight / len(bent)
        d_dx, d_dq = np.zeros_like(bent), np.zeros_like(turned)
        add_signs(bent, np.full(3, share / seen.unit, np.float32), d_dx)
        add_signs(turned, np.full(4, share, np.float32), d_dq)
        seen.slopes += seen.deformation.gradient(seen.points["means"], span_moments(seen.span), d_dx, d_dq)


def choose_span(frame: int, frames: int, last: int, rng: np.random.Generator) -> tuple[int, int, float] | None:
    """Return two frames up to `last` around a drawn frame, and a random position 0..1 between them; None if there are too few."""
    start = min(frame, max(last - TEMPORAL_WINDOW, 0))
    end = min(start + TEMPORAL_WINDOW, last)
    return None if frames < 3 or end <= start else (start, end, float(rng.uniform()))


def span_moments(span: tuple[int, int, float]) -> list[tuple[float, float]]:
    """Return the factors and times of the three moments that are compared."""
    start, end, between = span
    return [(1 - between, start), (between, end), (-1.0, start + between * (end - start))]


def _deviations(seen: GroupIteration) -> tuple[np.ndarray, np.ndarray]:
    """Return the differences [N, 3] and [N, 4] of the offsets from linear motion."""
    assert seen.span is not None
    means = seen.points["means"]
    bent, turned = np.zeros_like(means), np.zeros((len(means), 4), np.float32)
    for factor, time in span_moments(seen.span):
        dx, dq = seen.deformation.offsets(means, time)
        bent += np.float32(factor) * dx
        turned += np.float32(factor) * dq
    return bent, turned
