"""Parts of a layer, one file each. A player draws the first part alone while the others arrive."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from splatreel.codec.predictive.precision import SHAPE
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians

FIRST = 5000
"""Points of the first part, about 80 KB. Layers of at most twice as many points have one part."""
GROWTH = 4
"""Size of a part relative to the part before. The last part is a half to twice as large."""
_RADIUS = 3.0
"""Standard deviations within which a splat is visible."""


def part_sizes(count: int) -> list[int]:
    """Return the number of points of each part of a layer of `count` points."""
    sizes, size = [], FIRST
    while count > 2 * size:
        sizes.append(size)
        count -= size
        size *= GROWTH
    return [*sizes, count]


def split_layer(gaussians: Gaussians, classes: np.ndarray, cameras: Sequence[Camera]) -> list[np.ndarray]:
    """Return the indices of the points of each part, the parts of most visible points first.

    Large opaque points come first, so that the first part alone covers the image. Unimportant points, such as hidden
    ones, come last. Within a part points keep their order.

    Args:
        gaussians: Points of the layer, N.
        classes: Classes of the points, [N, 3], see `classes_of`.
        cameras: Cameras in which areas are measured. Without any, areas are those in the world.
    """
    sizes = part_sizes(len(gaussians))
    visibility = gaussians.opacities * _areas(gaussians, cameras) * 4.0 ** -classes[:, SHAPE]
    # Equal points are in one part, whatever their order.
    ranks = np.searchsorted(np.sort(-visibility), -visibility)
    parts = np.searchsorted(np.cumsum(sizes), ranks, side="right")
    return [some for part in range(len(sizes)) if len(some := np.flatnonzero(parts == part))]


def _areas(gaussians: Gaussians, cameras: Sequence[Camera]) -> np.ndarray:
    """Return the mean area of each splat in the images, [N], in pixels up to a factor.

    All arithmetic is element by element: a matrix product may round differently for points in another order.
    """
    _, middle, large = np.sort(gaussians.scales.astype(np.float64), axis=1).T
    if not cameras:
        return middle * large
    x, y, z = gaussians.means.astype(np.float64).T
    total = np.zeros(len(gaussians))
    for camera in cameras:
        rows, width, height = camera.viewmat.astype(np.float64), camera.width, camera.height
        right, down, depth = (row[0] * x + row[1] * y + row[2] * z + row[3] for row in rows[:3])
        (fx, _, cx), (_, fy, cy), _ = camera.K.astype(np.float64).tolist()
        near = np.where(depth > 0, depth, np.inf)
        u, v = fx * right / near + cx, fy * down / near + cy
        reach = _RADIUS * max(fx, fy) * large / near
        inside = (depth > 0) & (u > -reach) & (u < width + reach) & (v > -reach) & (v < height + reach)
        total += np.where(inside, np.minimum(fx * fy * middle * large / near**2, width * height), 0)
    return total / len(cameras)
