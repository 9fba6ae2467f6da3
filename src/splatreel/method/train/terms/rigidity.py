"""Rigidity of motion (paper section 4.2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from splatreel.kernels import motion
from splatreel.method.train.terms.term import GroupIteration, Neighbors, Term


@dataclass(frozen=True)
class Rigidity(Term[GroupIteration]):
    """L_arap: neighbors share rotation and translation, and keep their distance.

    It compares every point with one of its neighbors, of the same random rank for all points. Distances are divided by the typical
    viewing distance, so that the term does not depend on world units. Only the offsets get gradients. `kernels/motion.py` has the
    formula.

    Source:
        Section 4.2 of the paper.
    """

    wgsl: ClassVar[tuple[str, ...]] = ("rigidity",)

    def value(self, seen: GroupIteration) -> float:
        """See `Term`."""
        return 0.0 if seen.neighbors is None or seen.rank is None else _arap(seen, 1.0)[0]

    def add_to_points(self, seen: GroupIteration, weight: float) -> None:
        """See `Term`."""
        if seen.neighbors is None or seen.rank is None:
            return
        _, d_dx, d_dq = _arap(seen, weight)
        seen.add("dx", d_dx)
        seen.add("dq", d_dq)


def choose_rank(neighbors: Neighbors, rng: np.random.Generator) -> int:
    """Return the random rank of the neighbor that each point is compared with."""
    return int(rng.integers(len(neighbors.index)))


def _arap(seen: GroupIteration, weight: float) -> tuple[float, np.ndarray, np.ndarray]:
    """Return the value times a weight, and its gradients to dx and dq."""
    assert seen.neighbors is not None
    assert seen.rank is not None
    other, closeness = seen.neighbors.index[seen.rank], np.float32(weight) * seen.neighbors.closeness[seen.rank]
    return motion.arap(seen.points["means"], seen.points["dx"], seen.points["dq"], other, closeness, seen.unit)
