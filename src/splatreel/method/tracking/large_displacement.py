"""Large displacements of new points. Optical flow misses fast, small content unless it starts from a guess.

Each object, a connected cluster of points, is shifted as a whole to places around it, up to three times its size away. The
shift for which all views show the same colors is its motion.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from splatreel.kernels import photo_consistency
from splatreel.scene.camera import Camera

LINK_DISTANCE = 3.0
"""Points closer than this multiple of their size belong to one object."""
MIN_POINTS = 8
"""Minimum number of points of an object."""
MAX_SAMPLES = 64
"""Maximum number of points that are compared per object."""
REACH, STEPS = 3.0, 4
"""Range of the search, in multiples of the object's size (mean distance of its points from their center), and steps per range."""
ROUNDS = 3
"""Rounds in which the step is halved around the best place."""
MAX_RESIDUAL = 0.6
"""A shift must leave less than this share of the color difference without motion."""


def large_displacements(
    points: np.ndarray,
    sizes: np.ndarray,
    cameras: list[Camera],
    here: np.ndarray,
    there: np.ndarray,
    depths: np.ndarray,
    near: float,
) -> np.ndarray:
    """Return the motions [N, 3] float32 of new points between two moments; zero where no motion explains the images clearly better.

    Args:
        points: [N, 3] world.
        sizes: [N] standard deviations, world units.
        cameras: All cameras.
        here: [C, H, W, 3] uint8, images of the first moment.
        there: [C, H, W, 3] uint8, images of the second moment.
        depths: [C, H, W] depths of occluders at the first moment.
        near: Near plane, world units.
    """
    motions = np.zeros(points.shape, np.float32)
    views = np.stack([c.viewmat for c in cameras]), np.stack([c.K for c in cameras]), here, there, depths, near
    for members in _objects(points, sizes):
        chosen = points[members]
        size = float(np.linalg.norm(chosen - chosen.mean(0), axis=1).mean())
        motions[members] = _displacement(chosen[:: -(-len(chosen) // MAX_SAMPLES)], size, views)
    return motions


def _objects(points: np.ndarray, sizes: np.ndarray) -> list[np.ndarray]:
    """Return the indices of the points of each object: connected components of close points."""
    if len(points) < MIN_POINTS:
        return []
    near = KDTree(points).sparse_distance_matrix(KDTree(points), LINK_DISTANCE * float(np.median(sizes)))
    _, labels = connected_components(near, directed=False)
    return [np.flatnonzero(labels == label) for label in np.flatnonzero(np.bincount(labels) >= MIN_POINTS)]


def _displacement(points: np.ndarray, size: float, views: tuple) -> np.ndarray:
    """Return the motion [3] of one object. views: the last arguments of `photo_consistency.color_differences`."""
    grid = np.array(list(product(range(-STEPS, STEPS + 1), repeat=3)), np.float32)
    none = best = np.zeros(3, np.float32)
    step = REACH * size / STEPS
    for _ in range(ROUNDS + 1):
        tried = best + step * grid
        best = tried[photo_consistency.color_differences(points, tried, *views).argmin()]
        grid, step = grid[np.abs(grid).max(1) <= 1], step / 2
    unmoved, moved = photo_consistency.color_differences(points, np.stack([none, best]), *views)
    return best if moved < MAX_RESIDUAL * unmoved else none
