"""Nearest neighbors of points, which should move alike (paper section 4.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splatreel.kernels import splat


@dataclass(frozen=True)
class Neighbors:
    """The K nearest neighbors of N points, by rank.

    Attributes:
        index: [K, N] int64.
        closeness: [K, N], 1 where two points coincide.
    """

    index: np.ndarray
    closeness: np.ndarray

    @staticmethod
    def of(means: np.ndarray, count: int) -> Neighbors | None:
        """Find up to `count` neighbors for each of the means [N, 3]; return None for fewer than two points."""
        if len(means) < 2:
            return None
        index, distance = splat.nearest_neighbors(means, min(count, len(means) - 1))
        width = 2 * max(np.quantile(distance[:, -1], 0.5, method="lower"), np.float32(1e-9))
        closeness = np.exp(-((distance / width) ** 2))
        # An iteration uses one rank of all points.
        return Neighbors(np.ascontiguousarray(index.T), np.ascontiguousarray(closeness.T))
