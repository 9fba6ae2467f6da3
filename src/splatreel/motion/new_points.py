"""New points for what appears within a group: places that the rendered scene lacks, by space carving.

Dynamic points come from the keyframe, so what flies in later, or was lost, has none. Where the rendered scene differs from the
pictures, places along the pixels' rays are tried: one counts if the views that see it differ there and agree on its color. A
view that shows something nearer does not see it: a ball can be missing where somebody stands in front of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from scipy.spatial import KDTree

from splatreel.kernels import carve
from splatreel.scene.camera import Camera

ERROR, UNCERTAIN = 0.08, 0.06
"""Mean absolute color errors, 0..1, around a pixel: from the first on something is missing, from the second on it may be."""
MIN_AGREEMENT = 0.8
"""Share of the views that see a place whose masks must hold it."""
MAX_COLOR_DIFFERENCE = 0.1
"""Largest mean color difference, 0..1, between those views."""
MIN_CAMERAS = 0.3
"""Share of all cameras, and three at least, whose masks must hold a place: next to a camera a few agree on anything."""
MIN_DISTANCE = 6.0
"""How far from what moves already a new point must lie if it was found by uncertain masks, in multiples of its size."""
DEPTHS = 64
CLOSE = 8
"""What is nearer than this part of the depth behind it would fill the view: no place is tried there."""
RAYS = 4000


@dataclass(frozen=True)
class NewPoints:
    """points: [M, 3] world; colors: [M, 3] 0..1; sizes: [M] world, standard deviation, half the distance to the next point."""

    points: np.ndarray
    colors: np.ndarray
    sizes: np.ndarray

    def rows(self, index: np.ndarray) -> NewPoints:
        return NewPoints(self.points[index], self.colors[index], self.sizes[index])

    def joined(self, other: NewPoints) -> NewPoints:
        pairs = (self.points, other.points), (self.colors, other.colors), (self.sizes, other.sizes)
        return NewPoints(*(np.concatenate(pair) for pair in pairs))


class ErrorMasks(NamedTuple):
    """Where pictures differ from their truths. error: [..., H, W] bool, by more than noise and edges do; uncertain: at least a little.

    An object stands out in front of one wall and hardly in front of another, and one that is a pixel wide looks like an edge. So
    what is an error in a few views may be confirmed by others in which it is uncertain.
    """

    error: np.ndarray
    uncertain: np.ndarray


def error_masks(image: np.ndarray, truth: np.ndarray) -> ErrorMasks:
    """Of a rendered picture [H, W, 3] float against its truth (uint8)."""
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
    """Points of what is missing in the views.

    images: [C, H, W, 3] uint8; masks: of all views; depths: [C, H, W] of the scene as it is rendered, infinite for nothing.
    moving: [N, 3] the keyframe's dynamic points, where they are now. Close to them only errors count: these points are off a little,
    which training corrects.
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
        score = carve.disagreement(
            places, own, poses, lenses, images, support, depths, near, min_cameras, MIN_AGREEMENT
        )
        best = score.argmin(1)
        good = np.flatnonzero(score.min(1) < MAX_COLOR_DIFFERENCE)
        sizes = 0.5 * footprint[good, best[good]] * stride
        found.append(NewPoints(places[good, best[good]], own[good], sizes))
    certain, uncertain = found
    return _thinned(certain.joined(_away_from(uncertain, moving)))


def _away_from(found: NewPoints, moving: np.ndarray) -> NewPoints:
    """What lies away from points [N, 3]."""
    if len(moving) == 0 or len(found.points) == 0:
        return found
    distance = KDTree(moving).query(found.points)[0]
    return found.rows(np.flatnonzero(distance > MIN_DISTANCE * found.sizes))


def _rays(error: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """[R, 3] camera, row, column of the mask's pixels, an even choice of them."""
    rays = np.argwhere(error)
    return rays if len(rays) <= RAYS else rays[np.sort(rng.choice(len(rays), RAYS, replace=False))]


def _places(
    cameras: list[Camera], rays: np.ndarray, error: np.ndarray, depths: np.ndarray, near: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """[R, D, 3] places along the rays, near to the depth shown, evenly in inverse depth; [R, D] size of a pixel; rays' spacing."""
    camera, row, column = rays.T
    shown = depths[camera, row, column]
    finite = depths[np.isfinite(depths)]
    far = float(np.percentile(finite, 99)) if len(finite) else 20 * near
    end = np.minimum(np.where(np.isfinite(shown), 1.02 * shown, far), far).clip(1.05 * near)
    start = np.maximum(near, end / CLOSE)[:, None]
    inverse = 1 / start + (1 / end[:, None] - 1 / start) * np.linspace(0.02, 1, DEPTHS)
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
    """One point per cell of a grid, a little finer than their spacing."""
    if len(found.points) == 0:
        return found
    cell = 1.5 * float(np.median(found.sizes))
    _, first = np.unique(np.floor(found.points / cell).astype(np.int64), axis=0, return_index=True)
    return found.rows(first)
