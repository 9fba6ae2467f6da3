"""Nearest neighbors of points, by a k-d tree."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial import KDTree

from splatreel.base import threads
from splatreel.base.errors import GaussiansError


def nearest_neighbors(points: np.ndarray, k: int, queries: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return the k nearest points of each query: indices [Q, k] int64 and distances [Q, k] float32, nearest first.

    Args:
        points: [N, 3].
        k: Number of neighbors.
        queries: [Q, 3]. None: the points themselves, without each point's match with itself.

    Raises:
        GaussiansError: There are fewer than k points.
    """
    available = len(points) - (queries is None)
    if not 1 <= k <= available:
        raise GaussiansError(f"nearest_neighbors: asked for {k} neighbors where there are {available}.")
    ranks: Any = np.arange(1, k + 1 + (queries is None))  # a list, so that one neighbor still gives a column
    found = KDTree(points).query(points if queries is None else queries, k=ranks, workers=threads.count())
    distances, indices = np.asarray(found[0], np.float32), np.asarray(found[1], np.int64)
    return (indices, distances) if queries is not None else _without_self(indices, distances)


def _without_self(indices: np.ndarray, distances: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Remove each point from its own neighbors. Among coinciding points it is not always the first."""
    own = indices == np.arange(len(indices))[:, None]
    own[~own.any(1), -1] = True  # coinciding points took its place: drop the last neighbor instead
    shape = (len(indices), indices.shape[1] - 1)
    return indices[~own].reshape(shape), distances[~own].reshape(shape)
