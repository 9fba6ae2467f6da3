"""Initial points of a scene, from the first frame only (paper section 4.1, docs/parts.md).

The points are the capture's own sparse points, or points triangulated from matched features. A plane sweep adds surfaces
without features. Where its depth is uncertain, a few points take the depth of their surroundings, so that no visible place
starts empty.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.ndimage import binary_dilation
from scipy.spatial import KDTree

from splatreel.base import threads
from splatreel.base.errors import ReconstructionError
from splatreel.method.init import planesweep
from splatreel.method.init.planesweep import DepthMap, narrow_ranges, seen_depths
from splatreel.method.init.triangulate import triangulate
from splatreel.scene.camera import Camera, focus_point, inside, project, unproject
from splatreel.scene.volumes import Volume

MAX_POINTS = 25_000
ENOUGH_POINTS = 20
"""Sparse points that a camera must see for its depth range to follow from them."""
FAR_FACTOR = 4.0
"""Depths are searched up to this multiple of the depth of nearly all sparse points. Content behind windows or far outdoors has
few features. Planes are even in inverse depth, so this costs little."""
SWEEP_WIDTH = 240
SWEEP_PLANES = 80
FILL_PIXELS = 8
FILL_ANCHORS = 6
COLOR_DISTANCE = 0.5
"""Distance, pixels, that a difference of one gray level of 255 counts as when a depth is taken from a neighbor."""
RANDOM_POINTS = 10_000
FLAT_DEVIATION = 0.02
"""Standard deviation, 0..1, in a 5x5 patch below which a surface is flat and gets fewer points."""
FREE_SPACE = 0.1
"""A trusted depth that is farther than a point by more than this share contradicts the point."""


@dataclass(frozen=True)
class InitialPoints:
    """Initial points [P, 3] of a scene, their colors [P, 3] 0..1, and their source: capture, triangulated or random, then +swept."""

    points: np.ndarray
    colors: np.ndarray
    source: str


@dataclass(frozen=True)
class _Cloud:
    """points: [P, 3] float64. colors: [P, 3] 0..1. grain: [P] world units, size of the detail a point stands for: a few pixels."""

    points: np.ndarray
    colors: np.ndarray
    grain: np.ndarray

    def __getitem__(self, index: np.ndarray) -> _Cloud:
        return _Cloud(self.points[index], self.colors[index], self.grain[index])

    @staticmethod
    def concatenate(clouds: list[_Cloud]) -> _Cloud:
        return _Cloud(*(np.concatenate([getattr(c, n) for c in clouds]) for n in ("points", "colors", "grain")))


def initial_points(
    cameras: list[Camera],
    images: np.ndarray,
    points: np.ndarray | None = None,
    point_colors: np.ndarray | None = None,
    near: float | None = None,
    seed: int = 0,
    within: Volume | None = None,
) -> InitialPoints:
    """Find the points from which reconstruction starts.

    `points` are the capture's sparse points [P, 3] with colors [P, 3] 0..1; None triangulates them. `near` is the
    minimum distance of content from a camera, `within` the volume that all points are in.

    Raises:
        ReconstructionError: If images and cameras do not match, points are not finite, or none is in the volume.
    """
    _check(cameras, images, points)
    rng = np.random.default_rng(seed)
    if points is not None and len(points) > 0:
        source, sparse = "capture", np.asarray(points, np.float64)
        colors = (
            np.full(sparse.shape, 0.5, np.float32) if point_colors is None else np.asarray(point_colors, np.float32)
        )
    else:
        tracks = triangulate(cameras, images)
        source, sparse, colors = "triangulated", tracks.points, tracks.colors
    if within is not None:
        kept = within.contains(sparse)
        sparse, colors = sparse[kept], colors[kept]
    ranges = depth_ranges(cameras, sparse, near)
    maps: list[DepthMap] = []
    if len(cameras) > 1:
        width = min(SWEEP_WIDTH, images.shape[2])
        ranges, planes = narrow_ranges(cameras, ranges, width, SWEEP_PLANES)
        maps = planesweep.sweep(cameras, images, ranges, width=width, planes=planes)
        source += "+swept"
    needed = min(2, len(cameras) - 1)
    surfaces = threads.map_parallel(lambda k: _seen_surface(maps[k], needed, ranges[k]), range(len(maps)))
    found = _within(_Cloud.concatenate([_Cloud(sparse, colors, _finest_grain(cameras, sparse)), *surfaces]), within)
    if len(found.points) < ENOUGH_POINTS:
        found, source = _within(_random_points(cameras, images, ranges, rng), within), "random"
    else:
        filled = threads.map_parallel(lambda m: _within(_filled(m, needed, sparse), within), maps)
        found = _Cloud.concatenate([_thin(found, MAX_POINTS), *filled])
        found = found[~_refuted(found.points, maps, needed)]
    if not len(found.points):
        raise ReconstructionError(
            "The masks of the first frame have no place in common. Check that they belong to these cameras and frames, and start at a "
            "frame that shows the subject: --frames A:B."
        )
    return InitialPoints(found.points.astype(np.float32), np.clip(found.colors, 0, 1).astype(np.float32), source)


def near_plane(cameras: list[Camera], points: np.ndarray) -> float:
    """Return a near plane in front of nearly everything seen, world units.

    It is a quarter of the first percentile of the seen depths, clamped to 0.03..0.1 of the median depth. With a nearer plane,
    training places splats directly in front of a camera that looks into a room from its wall. A farther plane hides people who
    approach a camera.
    """
    depths = np.concatenate(seen_depths(cameras, np.asarray(points, np.float64)))
    if len(depths) < ENOUGH_POINTS:
        return 0.05 * _focus_distance(cameras)
    return float(np.clip(0.25 * np.percentile(depths, 1), 0.03 * np.median(depths), 0.1 * np.median(depths)))


def depth_ranges(cameras: list[Camera], points: np.ndarray, near: float | None = None) -> np.ndarray:
    """Return the nearest and farthest depth that each camera may see, [C, 2] world units.

    The range follows from the points in a camera's view, with a margin. A camera that sees too few takes the range of all
    points. Without points the distance to the cameras' common focus decides.
    """
    seen = seen_depths(cameras, points)
    pooled = np.concatenate(seen)
    ranges = np.empty((len(cameras), 2))
    for i, depths in enumerate(seen):
        chosen = depths if len(depths) >= ENOUGH_POINTS else pooled
        if len(chosen) >= ENOUGH_POINTS:
            low, high = np.percentile(chosen, [1, 99])
            ranges[i] = low / 1.4, high * FAR_FACTOR
        else:
            distance = _focus_distance(cameras)
            ranges[i] = 0.2 * distance, 4 * distance
    if near is not None:
        ranges[:, 0] = np.minimum(np.maximum(ranges[:, 0], near), 0.5 * ranges[:, 1])
    return ranges


def _check(cameras: list[Camera], images: np.ndarray, points: np.ndarray | None) -> None:
    if images.dtype != np.uint8 or images.ndim != 4 or images.shape[0] != len(cameras) or images.shape[3] != 3:
        raise ReconstructionError(
            f"Initial points: images have type {images.dtype} and shape {images.shape}; expected uint8 [{len(cameras)}, H, W, 3]."
        )
    for camera in cameras:
        if (camera.width, camera.height) != (images.shape[2], images.shape[1]):
            raise ReconstructionError(
                f"Initial points: camera {camera.name!r} is {camera.width}x{camera.height}, but its image is "
                f"{images.shape[2]}x{images.shape[1]}. Resize one of them."
            )
    if points is not None and not np.isfinite(points).all():
        raise ReconstructionError("Initial points: the capture's points contain NaN or infinity. Remove these points.")


def _within(cloud: _Cloud, volume: Volume | None) -> _Cloud:
    return cloud if volume is None else cloud[volume.contains(cloud.points)]


def _focus_distance(cameras: list[Camera]) -> float:
    """Return the mean distance of the cameras to the point they look at, at least the distance between them."""
    centers = np.stack([c.center for c in cameras]).astype(np.float64)
    spread = np.linalg.norm(centers - centers.mean(0), axis=1).max()
    distance = np.linalg.norm(centers - focus_point(cameras), axis=1).mean()
    return float(max(distance, spread, 1e-3))


def _finest_grain(cameras: list[Camera], points: np.ndarray) -> np.ndarray:
    """Return the size [P] of a pixel of a map in the nearest camera that sees each point; the median where no camera does."""
    grain = np.full(len(points), np.inf)
    for camera in cameras:
        pixels, depth = project(camera, points)
        size = depth / camera.K[0, 0] * camera.width / SWEEP_WIDTH
        grain = np.where(inside(camera, pixels), np.minimum(grain, size), grain)
    seen = np.isfinite(grain)
    return np.where(seen, grain, np.median(grain[seen]) if seen.any() else 1.0)


def _seen_surface(depth_map: DepthMap, needed: int, depth_range: np.ndarray) -> _Cloud:
    """Return the pixels whose depth at least `needed` neighbors confirm."""
    kept = (depth_map.agreeing >= needed) & (depth_map.depth < 0.98 * depth_range[1])
    gray = cv2.cvtColor(depth_map.image, cv2.COLOR_RGB2GRAY).astype(np.float32) / 255
    variance = cv2.blur(gray * gray, (5, 5)) - cv2.blur(gray, (5, 5)) ** 2
    grain = depth_map.depth / depth_map.camera.K[0, 0] * np.where(variance < FLAT_DEVIATION**2, 2, 1)
    points = unproject(depth_map.camera, depth_map.depth)
    return _Cloud(points[kept], depth_map.image[kept] / 255, grain[kept])


def _filled(depth_map: DepthMap, needed: int, sparse: np.ndarray) -> _Cloud:
    """Return points every few pixels where no depth is trusted, at the depth of pixels near in position and color.

    The depth is the second farthest of these. A point that is too far hides behind a surface; a point that is too near floats
    in front of it. A mean of foreground and background depth would be too near.
    """
    camera, image = depth_map.camera, depth_map.image
    trusted = depth_map.agreeing >= needed
    rows, columns = np.nonzero(trusted)
    pixels, depth = project(camera, sparse)
    visible = inside(camera, pixels)
    places = np.concatenate([np.stack([columns, rows], 1) + 0.5, pixels[visible]])
    inverse = 1 / np.concatenate([depth_map.depth[rows, columns], depth[visible]])
    if len(places) < FILL_ANCHORS:
        return _Cloud(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    shades = image[places[:, 1].astype(int), places[:, 0].astype(int)].astype(np.float64)
    centers = np.stack(np.meshgrid(*(np.arange(FILL_PIXELS // 2, n, FILL_PIXELS) for n in image.shape[:2])), -1)
    row, column = centers.reshape(-1, 2).T
    covered = np.zeros(len(row), bool)
    for k, (r, c) in enumerate(zip(row, column, strict=True)):
        covered[k] = trusted[max(r - 4, 0) : r + 4, max(c - 4, 0) : c + 4].any()
    row, column = row[~covered], column[~covered]
    colors = image[row, column].astype(np.float64)
    tree = KDTree(np.c_[places, COLOR_DISTANCE * shades])
    _, anchor = tree.query(np.c_[column + 0.5, row + 0.5, COLOR_DISTANCE * colors], k=FILL_ANCHORS)
    borrowed = np.sort(inverse[anchor], 1)[:, 1]
    target = np.ones(image.shape[:2])
    target[row, column] = 1 / borrowed
    return _Cloud(unproject(camera, target)[row, column], colors / 255, FILL_PIXELS / borrowed / camera.K[0, 0])


def _refuted(points: np.ndarray, maps: list[DepthMap], needed: int) -> np.ndarray:
    """Return [P] bool, the points that more trusted depths look through than confirm."""

    def balance_of(m: DepthMap) -> np.ndarray:
        balance = np.zeros(len(points), int)
        pixels, depth = project(m.camera, points)
        visible = np.flatnonzero(inside(m.camera, pixels))
        column, row = pixels[visible].astype(int).T
        visible, column, row = (a[m.agreeing[row, column] >= needed] for a in (visible, column, row))
        beyond = m.depth[row, column] / depth[visible] - 1
        balance[visible] = (beyond > FREE_SPACE).astype(int) - (np.abs(beyond) <= FREE_SPACE / 2)
        return balance

    return np.sum(threads.map_parallel(balance_of, maps), 0) > 0


def _random_points(cameras: list[Camera], images: np.ndarray, ranges: np.ndarray, rng: np.random.Generator) -> _Cloud:
    """Return points at random pixels and random inverse depths of all cameras, with the colors of the pixels."""
    count = -(-RANDOM_POINTS // len(cameras))
    points, colors = [], []
    for camera, image, (low, high) in zip(cameras, images, ranges, strict=True):
        row, column = rng.integers(camera.height, size=count), rng.integers(camera.width, size=count)
        depth = 1 / rng.uniform(1 / high, 1 / low, count)
        rays = unproject(camera, np.ones(image.shape[:2]))[row, column] - camera.center
        points.append(camera.center + rays * depth[:, None])
        colors.append(image[row, column] / 255)
    return _Cloud(np.concatenate(points), np.concatenate(colors), np.ones(count * len(cameras)))


def _thin(cloud: _Cloud, limit: int) -> _Cloud:
    """Average a cloud over the smallest voxels that `limit` allows. Voxel sizes follow the points' grain in powers of two."""
    level = np.rint(np.log2(cloud.grain)).astype(int)
    low, high = 0.25, 1024.0
    while high / low > 1.05:
        size = np.sqrt(low * high)
        if len(_voxels(cloud.points, size, level)[1]) > limit:
            low = size
        else:
            high = size
    index, counts = _voxels(cloud.points, high, level)
    sums = np.zeros((len(counts), 7))
    np.add.at(sums, index, np.c_[cloud.points, cloud.colors, cloud.grain])
    means = sums / counts[:, None]
    return _Cloud(means[:, :3], means[:, 3:6], means[:, 6])


def _voxels(points: np.ndarray, size: float, level: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the voxel index of every point [P], and the number of points per voxel [V]. Voxels are size * 2^level wide."""
    cells = np.floor(points / (size * np.exp2(level))[:, None]).astype(np.int64)
    cells -= cells.min(0)
    extent = cells.max(0) + 1
    keys = ((level - level.min()) * extent[0] + cells[:, 0]) * extent[1] + cells[:, 1]
    _, index, counts = np.unique(keys * extent[2] + cells[:, 2], return_inverse=True, return_counts=True)
    return index, counts


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

    Points that few cameras match cover a part of the subject only. The hull of the masks encloses the rest. Cells that
    several cameras see in different colors are carved away. A cell that no camera sees takes the color of the nearest seen
    one. `hull` is the visual hull of the subject. `images` [C, H, W, 3] lack their backgrounds.

    Source:
        Kutulakos and Seitz 2000, "A theory of shape by space carving".
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
