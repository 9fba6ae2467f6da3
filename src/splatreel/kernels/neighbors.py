"""Nearest neighbors of points, by a k-d tree on the CPU for tensors of any device."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from scipy.spatial import KDTree
from torch import Tensor

from splatreel.base import threads


def nearest_neighbors(points: Tensor, k: int, queries: Tensor | None) -> tuple[Tensor, Tensor]:
    """Return indices and distances of the nearest points, see `splat.nearest_neighbors`.

    All pairs of 50,000 points take a GPU longer than the tree takes a CPU.
    """
    asked = points if queries is None else queries
    ranks: Any = np.arange(1, k + 1 + (queries is None))  # a list, so that one neighbor still gives a column
    tree = KDTree(points.detach().cpu().numpy())
    found = tree.query(asked.detach().cpu().numpy(), k=ranks, workers=threads.count())
    distances, indices = np.asarray(found[0], np.float32), np.asarray(found[1], np.int64)
    if queries is None:
        indices, distances = _without_self(indices, distances)
    return torch.from_numpy(indices).to(points.device), torch.from_numpy(distances).to(points.device)


def _without_self(indices: np.ndarray, distances: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Remove each point from its own neighbors. Among coinciding points it is not always the first."""
    own = indices == np.arange(len(indices))[:, None]
    own[~own.any(1), -1] = True  # coinciding points took its place: drop the last neighbor instead
    shape = (len(indices), indices.shape[1] - 1)
    return indices[~own].reshape(shape), distances[~own].reshape(shape)
