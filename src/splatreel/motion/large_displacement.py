"""How things that just appeared move: nothing is known of them, and what is fast and small flow does not find without a guess.

Each thing is carried as a whole to places around it, by its own size and more, and the one where all views show the same is it.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from splatreel.kernels.cpu import match
from splatreel.scene.camera import Camera

LINK = 3.0
"""Points nearer than this many times their sizes are of one thing."""
LEAST = 8
"""Points of the smallest thing that is looked for."""
SAMPLES = 64
REACH, STEPS = 3.0, 4
"""How far a thing is looked for, in multiples of its size (the distance of its points from their mean), and in how many steps."""
ROUNDS = 3
"""In which the steps are halved around the best place."""
BETTER = 0.6
"""Of the difference without any motion, what a leap must be below."""


def leaps(
    points: np.ndarray,
    sizes: np.ndarray,
    cameras: list[Camera],
    here: np.ndarray,
    there: np.ndarray,
    depths: np.ndarray,
    near: float,
) -> np.ndarray:
    """Motions [N, 3] float32 of new points from one moment to another; none where no motion explains the pictures clearly better.

    points: [N, 3] world; sizes: [N]. here, there: [C, H, W, 3] uint8, the pictures of the two moments. depths: [C, H, W] of what may
    hide the points now.
    """
    motions = np.zeros(points.shape, np.float32)
    views = np.stack([c.viewmat for c in cameras]), np.stack([c.K for c in cameras]), here, there, depths, near
    for thing in _things(points, sizes):
        chosen = points[thing]
        size = float(np.linalg.norm(chosen - chosen.mean(0), axis=1).mean())
        motions[thing] = _leap(chosen[:: -(-len(chosen) // SAMPLES)], size, views)
    return motions


def _things(points: np.ndarray, sizes: np.ndarray) -> list[np.ndarray]:
    """Indices of the points of each thing."""
    if len(points) < LEAST:
        return []
    near = KDTree(points).sparse_distance_matrix(KDTree(points), LINK * float(np.median(sizes)))
    _, labels = connected_components(near, directed=False)
    return [np.flatnonzero(labels == label) for label in np.flatnonzero(np.bincount(labels) >= LEAST)]


def _leap(points: np.ndarray, size: float, views: tuple) -> np.ndarray:
    """The motion [3] of one thing. size: of it. views: what `match.mismatch` wants to know of them."""
    grid = np.array(list(product(range(-STEPS, STEPS + 1), repeat=3)), np.float32)
    none = best = np.zeros(3, np.float32)
    step = REACH * size / STEPS
    for _ in range(ROUNDS + 1):
        tried = best + step * grid
        best = tried[match.mismatch(points, tried, *views).argmin()]
        grid, step = grid[np.abs(grid).max(1) <= 1], step / 2
    still, moved = match.mismatch(points, np.stack([none, best]), *views)
    return best if moved < BETTER * still else none
