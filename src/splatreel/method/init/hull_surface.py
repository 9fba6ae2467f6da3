"""First points on the surface of a subject before few cameras, which close it all around.

Points that few cameras match cover a part of the subject only. The hull of the masks encloses the rest. Cells of the hull that
several cameras see in different colors are carved away. A cell that no camera sees takes the color of the nearest seen one.

Source:
    Kutulakos and Seitz 2000, "A theory of shape by space carving".
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.ndimage import binary_dilation
from scipy.spatial import KDTree

from splatreel.method.init.initial_points import SWEEP_WIDTH, InitialPoints
from splatreel.scene.camera import Camera, inside, project
from splatreel.scene.volumes import Volume

CELL = 1.5
"""Width of a cell, pixels of an image that is `SWEEP_WIDTH` wide."""
MOST_CELLS = 50_000_000
"""Number of cells above which they are made larger."""
REACH = 5
"""Cells around a first point in which the surface is searched."""
DIFFERENT = 0.15
"""Standard deviation of a color channel over the cameras, 0..1, above which a cell is carved."""
PASSES = 6
"""Number of passes that carve. Each of them removes one layer of cells at most."""
DEPTH = 2.5
"""Depth, cells, behind the first cell of a pixel that is seen too."""


def close_surface(
    first: InitialPoints, cameras: list[Camera], images: np.ndarray, hull: Volume, unit: float
) -> InitialPoints:
    """Return the first points within the carved hull, and a point in each cell of its surface.

    Args:
        first: First points, which are near all parts of the subject.
        cameras: Training cameras.
        images: [C, H, W, 3] uint8 of the first frame, without backgrounds.
        hull: Hull of the subject.
        unit: Typical viewing distance, world units.
    """
    points = first.points.astype(np.float64)
    grid = _Grid.around(points, CELL * unit / np.median([SWEEP_WIDTH / c.width * c.K[0, 0] for c in cameras]))
    filled, empty = _cells(grid, points, hull)

    def look() -> tuple[np.ndarray, _Surface]:
        cells = np.argwhere(filled & binary_dilation(empty))
        return cells, _colors(grid.centers(cells), cameras, images, DEPTH * grid.size)

    cells, surface = look()
    for _ in range(PASSES):
        if not surface.differs.any():
            break
        carved = tuple(cells[surface.differs].T)
        filled[carved], empty[carved] = False, True
        cells, surface = look()
    surface = surface[~surface.differs]
    if not surface.seen.any():
        return first
    colors, unseen = surface.colors, ~surface.seen
    if unseen.any():
        nearest = KDTree(surface.points[surface.seen]).query(surface.points[unseen])[1]
        colors[unseen] = colors[surface.seen][nearest]
    kept = np.asarray(binary_dilation(filled), bool)[tuple(grid.cells(points).T)]
    return InitialPoints(
        np.concatenate([first.points[kept], surface.points]).astype(np.float32),
        np.concatenate([first.colors[kept], colors]).astype(np.float32),
        first.source + "+hull",
    )


@dataclass(frozen=True)
class _Grid:
    """Cells of space. low: [3] its corner. size: width of a cell, world units. shape: number of cells along each axis."""

    low: np.ndarray
    size: float
    shape: tuple[int, ...]

    @staticmethod
    def around(points: np.ndarray, size: float) -> _Grid:
        """Return the cells around points [P, 3], larger ones if there would be too many."""
        margin = (REACH + 2) * size
        low, high = points.min(0) - margin, points.max(0) + margin
        size = max(size, float(np.cbrt(np.prod(high - low) / MOST_CELLS)))
        return _Grid(low, size, tuple(np.ceil((high - low) / size).astype(int) + 1))

    def cells(self, points: np.ndarray) -> np.ndarray:
        """Return the cells [P, 3] of points [P, 3]."""
        return ((points - self.low) / self.size).astype(np.int64)

    def centers(self, cells: np.ndarray) -> np.ndarray:
        """Return the centers [P, 3] of cells [P, 3]."""
        return self.low + (cells + 0.5) * self.size


@dataclass(frozen=True)
class _Surface:
    """Cells of a surface.

    points: [P, 3]. colors: [P, 3], mean over the cameras that see a cell. seen: [P] bool. differs: [P] bool, cameras disagree.
    """

    points: np.ndarray
    colors: np.ndarray
    seen: np.ndarray
    differs: np.ndarray

    def __getitem__(self, index: np.ndarray) -> _Surface:
        return replace(
            self,
            points=self.points[index],
            colors=self.colors[index],
            seen=self.seen[index],
            differs=self.differs[index],
        )


def _cells(grid: _Grid, points: np.ndarray, hull: Volume) -> tuple[np.ndarray, np.ndarray]:
    """Return which cells near points [P, 3] are within the hull, and which are outside, bool of the grid's shape."""
    near = np.zeros(grid.shape, bool)
    near[tuple(grid.cells(points).T)] = True
    cells = np.argwhere(binary_dilation(near, iterations=REACH))
    within = hull.contains(grid.centers(cells))
    filled, empty = np.zeros(grid.shape, bool), np.zeros(grid.shape, bool)
    filled[tuple(cells[within].T)] = True
    empty[tuple(cells[~within].T)] = True
    return filled, empty


def _colors(points: np.ndarray, cameras: list[Camera], images: np.ndarray, depth: float) -> _Surface:
    """Return a surface with the colors in which the cameras see it. depth: see `DEPTH`, world units."""
    sums, squares, count = np.zeros_like(points), np.zeros_like(points), np.zeros(len(points))
    for camera, image in zip(cameras, images, strict=True):
        pixels, depths = project(camera, points)
        shown = np.flatnonzero(inside(camera, pixels) & (depths > 0))
        column, row = pixels[shown].astype(np.int64).T
        front = np.full((camera.height, camera.width), np.inf, np.float32)
        np.minimum.at(front, (row, column), depths[shown])
        size = max(3, round(2 * CELL * camera.width / SWEEP_WIDTH) | 1)  # cells leave no gaps between them
        front = cv2.erode(front, np.ones((size, size), np.uint8))
        visible = depths[shown] <= front[row, column] + depth
        found, color = shown[visible], image[row[visible], column[visible]] / 255
        sums[found] += color
        squares[found] += color**2
        count[found] += 1
    mean = sums / np.maximum(count, 1)[:, None]
    deviation = np.sqrt(np.maximum(squares / np.maximum(count, 1)[:, None] - mean**2, 0)).max(1)
    return _Surface(points, mean, count > 0, (count > 1) & (deviation > DIFFERENT))
