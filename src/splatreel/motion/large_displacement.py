"""Large displacements of new points: optical flow does not find what is fast and small unless it starts from a guess.

Each object, a connected cluster of points, is shifted as a whole to places around it, up to three times its size away. The shift
after which all views show the same colors is its motion.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from splatreel.kernels import translation
from splatreel.scene.camera import Camera

LINK = 3.0
"""Points nearer than this many times their sizes are of one object."""
MIN_POINTS = 8
"""Points of the smallest object that is looked for."""
MAX_SAMPLES = 64
"""Points by which an object is judged, at most."""
REACH, STEPS = 3.0, 4
"""How far an object is looked for, in multiples of its size (the distance of its points from their mean), and in how many steps."""
ROUNDS = 3
"""In which the steps are halved around the best place."""
BETTER = 0.6
"""A shift must leave less than this share of the color difference without any motion."""


def large_displacements(
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
    for members in _objects(points, sizes):
        chosen = points[members]
        size = float(np.linalg.norm(chosen - chosen.mean(0), axis=1).mean())
        motions[members] = _displacement(chosen[:: -(-len(chosen) // MAX_SAMPLES)], size, views)
    return motions


def _objects(points: np.ndarray, sizes: np.ndarray) -> list[np.ndarray]:
    """Indices of the points of each object: connected components of points that are near each other."""
    if len(points) < MIN_POINTS:
        return []
    near = KDTree(points).sparse_distance_matrix(KDTree(points), LINK * float(np.median(sizes)))
    _, labels = connected_components(near, directed=False)
    return [np.flatnonzero(labels == label) for label in np.flatnonzero(np.bincount(labels) >= MIN_POINTS)]


def _displacement(points: np.ndarray, size: float, views: tuple) -> np.ndarray:
    """The motion [3] of one object. size: of it. views: the last arguments of `translation.color_differences`."""
    grid = np.array(list(product(range(-STEPS, STEPS + 1), repeat=3)), np.float32)
    none = best = np.zeros(3, np.float32)
    step = REACH * size / STEPS
    for _ in range(ROUNDS + 1):
        tried = best + step * grid
        best = tried[translation.color_differences(points, tried, *views).argmin()]
        grid, step = grid[np.abs(grid).max(1) <= 1], step / 2
    resting, moved = translation.color_differences(points, np.stack([none, best]), *views)
    return best if moved < BETTER * resting else none
