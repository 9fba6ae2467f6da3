"""Bodies within a visual hull: what is far from all skeletons is removed, if every mask stays covered without it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import binary_closing, binary_dilation

from splatreel.method.images.people import find_people
from splatreel.method.init.skeleton import Skeleton, capsules, find_skeletons
from splatreel.method.init.visual_hull import VisualHull
from splatreel.scene.camera import Camera
from splatreel.scene.volumes import Volume, in_image

LIKELY = 128
"""Opacity from which a pixel must stay covered."""
CELLS = 110
"""Cells along the height of a body."""
MOST_CELLS = 12_000_000
"""Number of cells above which they are made larger."""
AROUND = 0.5
"""Distance from the landmarks within which places are removed, as a share of the body's height."""
STRIDE = 2
"""Cells between those that are looked at first."""
MARGIN = 0.03
"""Distance from the capsules that always stays, as a share of the body's height. Landmarks and clothes differ from bones."""
WIDE = 0.03
"""Half width, as a share of the body's height, of a part of a mask that no body explains and that is a thing of its own."""
DEPTH = 2
"""Depth of what covers the rest of a mask, cells."""
CONFIRMING = 2
"""Number of masks that must show a thing in such a part."""


@dataclass(frozen=True)
class BodyHull:
    """Visual hull in which cells of a grid are removed.

    Attributes:
        hull: The visual hull.
        low: [3] corner of the grid.
        size: Width of a cell, world units.
        kept: Cells that stay, bool.
    """

    hull: Volume
    low: np.ndarray
    size: float
    kept: np.ndarray

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Return which points [..., 3] are inside, [...] bool."""
        cells = np.floor((points - self.low) / self.size).astype(np.int64)
        within = np.all((cells >= 0) & (cells < self.kept.shape), axis=-1)
        x, y, z = np.moveaxis(np.where(within[..., None], cells, 0), -1, 0)
        return self.hull.contains(points) & (~within | self.kept[x, y, z])

    def bounds(self) -> None:
        """Return None: the hull has no simple box."""
        return


def subject_hull(cameras: Sequence[Camera], images: np.ndarray, alpha: np.ndarray, near: float = 0.0) -> Volume:
    """Return the visual hull of a subject before few cameras, with the bodies of people in it where their networks are installed.

    Args:
        cameras: C cameras.
        images: [C, H, W, 3] uint8.
        alpha: [C, H, W] uint8, opacity of the subject.
        near: Smallest depth, world units.
    """
    hull, people = VisualHull(list(cameras), alpha, near), find_people()
    if people is None:
        return hull
    masks = alpha >= LIKELY
    return with_bodies(hull, find_skeletons(cameras, images, masks, hull, people), cameras, masks, near)


def with_bodies(
    hull: Volume, skeletons: Sequence[Skeleton], cameras: Sequence[Camera], masks: np.ndarray, near: float = 0.0
) -> Volume:
    """Return a visual hull without the places that only the gaps between the cameras allow.

    Places near capsules along the bones stay. So do things that at least two masks show beside the bodies. What they leave uncovered
    of a mask, the places nearest to a body cover, so that no pixel of a mask is ever uncovered.

    Args:
        hull: Visual hull of the masks.
        skeletons: Skeletons of the people.
        cameras: C cameras.
        masks: [C, H, W] bool, pixels of the subject.
        near: Smallest depth, world units.
    """
    if not skeletons:
        return hull
    low, size, shape = _grid(skeletons)
    inside = _inside(hull, low, size, shape)
    cells = np.argwhere(inside)
    points = low + (cells + 0.5) * size
    away = np.full(len(points), np.inf, np.float32)
    for skeleton in skeletons:
        away = np.minimum(away, capsules(skeleton, cameras, masks).distances(points) / skeleton.height)
    kept = away <= MARGIN
    cell = size / float(np.median([skeleton.height for skeleton in skeletons]))
    views = [_View.of(camera, mask, points, near, size) for camera, mask in zip(cameras, masks, strict=True)]
    confirming = np.zeros(len(points), np.int64)
    for view in views:
        confirming += view.shown(view.wide_parts(view.uncovered(kept), WIDE / cell))
    kept |= confirming >= CONFIRMING
    nearest = np.zeros(len(points), bool)
    for view in views:
        nearest |= view.nearest(view.uncovered(kept), away, DEPTH * cell)
    volume = np.zeros(shape, bool)
    volume[tuple(cells[kept | nearest].T)] = True
    return BodyHull(hull, low, size, (binary_closing(volume) | volume) & inside)


def _grid(skeletons: Sequence[Skeleton]) -> tuple[np.ndarray, float, tuple[int, ...]]:
    """Return the corner, the width of a cell and the shape of a grid around skeletons."""
    reach = AROUND * max(skeleton.height for skeleton in skeletons)
    low = np.min([np.nanmin(skeleton.points, 0) for skeleton in skeletons], 0) - reach
    high = np.max([np.nanmax(skeleton.points, 0) for skeleton in skeletons], 0) + reach
    size = float(np.median([skeleton.height for skeleton in skeletons])) / CELLS
    size = max(size, float(np.cbrt(np.prod(high - low) / MOST_CELLS)))
    return low, size, tuple(np.ceil((high - low) / size).astype(int))


def _inside(hull: Volume, low: np.ndarray, size: float, shape: tuple[int, ...]) -> np.ndarray:
    """Return which cells of a grid are in the hull. Cells are skipped if none of those two cells away is: masks are dilated by more."""
    some = np.zeros(shape, bool)
    corners = np.stack(np.meshgrid(*(np.arange(0, length, STRIDE) for length in shape), indexing="ij"), -1)
    some[::STRIDE, ::STRIDE, ::STRIDE] = hull.contains(low + (corners + 0.5) * size)
    cells = np.argwhere(binary_dilation(some, np.ones((3, 3, 3), bool), iterations=STRIDE))
    inside = np.zeros(shape, bool)
    inside[tuple(cells[hull.contains(low + (cells + 0.5) * size)].T)] = True
    return inside


@dataclass(frozen=True)
class _View:
    """Cells in the image of a camera.

    Attributes:
        mask: [H, W] bool.
        seen: [N] bool, cells in the image.
        pixels: [N] index of each cell's pixel.
        cell: Width of a cell, pixels.
    """

    mask: np.ndarray
    seen: np.ndarray
    pixels: np.ndarray
    cell: float

    @staticmethod
    def of(camera: Camera, mask: np.ndarray, points: np.ndarray, near: float, size: float) -> _View:
        seen, pixels, depth = in_image(points, camera, near)
        column, row = np.where(seen[:, None], pixels, 0).astype(np.int64).T
        cell = size * float(camera.K[0, 0]) / float(np.median(depth[seen])) if seen.any() else 1.0
        return _View(mask, seen, row * camera.width + column, cell)

    def uncovered(self, kept: np.ndarray) -> np.ndarray:
        """Return the pixels of the mask that no kept cell covers, [H, W] bool."""
        covered = np.zeros(self.mask.size, np.uint8)
        covered[self.pixels[kept & self.seen]] = 1
        return self.mask & (cv2.morphologyEx(covered.reshape(self.mask.shape), cv2.MORPH_CLOSE, self._kernel()) == 0)

    def wide_parts(self, uncovered: np.ndarray, width: float) -> np.ndarray:
        """Return the parts of uncovered pixels with a half width of so many cells."""
        radius = max(1, round(width * self.cell))
        kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
        return cv2.morphologyEx(uncovered.astype(np.uint8), cv2.MORPH_OPEN, kernel) > 0

    def shown(self, part: np.ndarray) -> np.ndarray:
        """Return which cells are seen within a part [H, W] bool of the image."""
        return self.seen & part.ravel()[self.pixels]

    def nearest(self, part: np.ndarray, away: np.ndarray, tolerance: float) -> np.ndarray:
        """Return the cells that are nearest to a body of all cells before a pixel, for the pixels of a part."""
        shown = np.flatnonzero(self.shown(part))
        least = np.full(self.mask.size, np.inf, np.float32)
        np.minimum.at(least, self.pixels[shown], away[shown])
        found = np.zeros(len(away), bool)
        found[shown[away[shown] <= least[self.pixels[shown]] + tolerance]] = True
        return found

    def _kernel(self) -> np.ndarray:
        """Return a square that closes the gaps between cells."""
        side = 2 * int(np.ceil(self.cell / 2)) + 1
        return np.ones((side, side), np.uint8)
