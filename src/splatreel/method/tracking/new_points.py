"""New points for content that appears within a group, found by space carving.

Dynamic points come from the keyframe, so content that appears later has none. Where the rendered scene differs from the images,
places along the pixels' rays are tried. A place counts if the views that see it differ there and agree on its color. A view
that shows something nearer does not see the place.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from scipy.spatial import KDTree

from splatreel.kernels import photo_consistency
from splatreel.scene.camera import Camera

ERROR, UNCERTAIN = 0.08, 0.06
"""Mean absolute color errors around a pixel, 0..1: above `ERROR` content is missing, above `UNCERTAIN` it may be."""
MIN_AGREEMENT = 0.8
"""Share of the views that see a place whose masks must contain it."""
MAX_COLOR_DIFFERENCE = 0.1
"""Maximum mean color difference between those views, 0..1."""
MIN_CAMERAS = 0.3
"""Share of all cameras, at least three, whose masks must contain a place. A few cameras agree on anything next to a camera."""
MIN_DISTANCE = 6.0
"""Minimum distance from moving points of a new point that uncertain masks found, in multiples of its size."""
DEPTH_SAMPLES = 64
NEAREST_FRACTION = 8
"""Places nearer than the depth behind them divided by this are not tried: content there would fill the view."""
MAX_RAYS = 4000


@dataclass(frozen=True)
class NewPoints:
    """New points [M, 3], their colors [M, 3] 0..1, and standard deviations `sizes` [M]: half the distance to the next point."""

    points: np.ndarray
    colors: np.ndarray
    sizes: np.ndarray

    def rows(self, index: np.ndarray) -> NewPoints:
        """Select points by index."""
        return NewPoints(self.points[index], self.colors[index], self.sizes[index])

    def joined(self, other: NewPoints) -> NewPoints:
        """Concatenate with other points."""
        pairs = (self.points, other.points), (self.colors, other.colors), (self.sizes, other.sizes)
        return NewPoints(*(np.concatenate(pair) for pair in pairs))


class ErrorMasks(NamedTuple):
    """Pixels in which images differ from their targets.

    An object stands out in front of one wall and hardly in front of another, and a pixel-wide object looks like an edge. Errors
    in a few views may therefore be confirmed by views in which they are uncertain.

    Attributes:
        error: [..., H, W] bool, differences larger than those of noise and edges.
        uncertain: [..., H, W] bool, differences that may be errors.
    """

    error: np.ndarray
    uncertain: np.ndarray


def error_masks(image: np.ndarray, truth: np.ndarray) -> ErrorMasks:
    """Compare a rendered image [H, W, 3] float with its target (uint8)."""
    difference = cv2.absdiff(image, truth.astype(np.float32) / 255)
    difference = cv2.transform(difference, np.full((1, 3), 1 / 3, np.float32))
    smooth = cv2.GaussianBlur(difference, (5, 5), 1.2)
    mask = cv2.morphologyEx((smooth > ERROR).astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    return ErrorMasks(mask > 0, smooth > UNCERTAIN)


def find_new_points(
    cameras: list[Camera],
    images: np.ndarray,
    masks: ErrorMasks,
    depths: np.ndarray,
    near: float,
    moving: np.ndarray,
    seed: int = 0,
) -> NewPoints:
    """Find points of the content that is missing in the rendered scene.

    `depths` [C, H, W] are of the rendered scene, infinite for nothing. Close to `moving` points [N, 3] only certain
    errors count, since training corrects small misplacements.
    """
    rays = _rays(masks.error, np.random.default_rng(seed))
    if len(rays) == 0:
        return NewPoints(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32), np.zeros(0, np.float32))
    places, footprint, stride = _places(cameras, rays, masks.error, depths, near)
    own = images[rays[:, 0], rays[:, 1], rays[:, 2]].astype(np.float32) / 255
    poses, lenses = np.stack([c.viewmat for c in cameras]), np.stack([c.K for c in cameras])
    min_cameras = max(3, MIN_CAMERAS * len(cameras))
    found = []
    for support in masks:
        score = photo_consistency.disagreement(
            places, own, poses, lenses, images, support, depths, near, min_cameras, MIN_AGREEMENT
        )
        best = score.argmin(1)
        good = np.flatnonzero(score.min(1) < MAX_COLOR_DIFFERENCE)
        sizes = 0.5 * footprint[good, best[good]] * stride
        found.append(NewPoints(places[good, best[good]], own[good], sizes))
    certain, uncertain = found
    return _thinned(certain.joined(_away_from(uncertain, moving)))


def _away_from(found: NewPoints, moving: np.ndarray) -> NewPoints:
    """Select new points that are away from points [N, 3]."""
    if len(moving) == 0 or len(found.points) == 0:
        return found
    distance = KDTree(moving).query(found.points)[0]
    return found.rows(np.flatnonzero(distance > MIN_DISTANCE * found.sizes))


def _rays(error: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return an even choice of the mask's pixels, [R, 3]: camera, row, column."""
    rays = np.argwhere(error)
    return rays if len(rays) <= MAX_RAYS else rays[np.sort(rng.choice(len(rays), MAX_RAYS, replace=False))]


def _places(
    cameras: list[Camera], rays: np.ndarray, error: np.ndarray, depths: np.ndarray, near: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return places [R, D, 3] along rays, evenly in inverse depth up to the visible surface, their sizes, and the spacing of rays."""
    camera, row, column = rays.T
    shown = depths[camera, row, column]
    finite = depths[np.isfinite(depths)]
    far = float(np.percentile(finite, 99)) if len(finite) else 20 * near
    end = np.minimum(np.where(np.isfinite(shown), 1.02 * shown, far), far).clip(1.05 * near)
    start = np.maximum(near, end / NEAREST_FRACTION)[:, None]
    inverse = 1 / start + (1 / end[:, None] - 1 / start) * np.linspace(0.02, 1, DEPTH_SAMPLES)
    z = 1 / inverse
    K = np.stack([c.K for c in cameras])[camera]
    poses = np.stack([c.viewmat for c in cameras])[camera]
    directions = np.stack(
        [(column + 0.5 - K[:, 0, 2]) / K[:, 0, 0], (row + 0.5 - K[:, 1, 2]) / K[:, 1, 1], np.ones(len(rays))], 1
    )
    local = directions[:, None] * z[..., None] - poses[:, None, :3, 3]
    places = np.einsum("rdi,rij->rdj", local, poses[:, :3, :3])
    stride = float(np.sqrt(max(error.sum() / len(rays), 1.0)))
    return places.astype(np.float32), (z / K[:, 0, 0][:, None]).astype(np.float32), stride


def _thinned(found: NewPoints) -> NewPoints:
    """Keep one point per cell of a grid that is a little finer than their spacing."""
    if len(found.points) == 0:
        return found
    cell = 1.5 * float(np.median(found.sizes))
    _, first = np.unique(np.floor(found.points / cell).astype(np.int64), axis=0, return_index=True)
    return found.rows(first)
