"""Things that appear: where several views agree that the picture lacks something, and what it looks like there.

Dynamic points come from the keyframe, so what flies in later, or was lost, has none. At such a frame the pixels where the rendered
scene is wrong are carved into space: a place counts if the views that see it doubt the picture there and agree on its colour. A
view that shows something nearer there does not see it: a ball is missing also where somebody stands before it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from scipy.spatial import KDTree

from splatreel.kernels.cpu import carve
from splatreel.scene.camera import Camera

WRONG, DOUBT = 0.08, 0.06
"""Mean absolute colour errors, 0..1, of a pixel's surroundings: that of something missing, and what bears other views out."""
AGREE = 0.8
"""Share of the views that see a place that must doubt it."""
COLOR = 0.1
"""Largest mean colour difference, 0..1, between those views."""
VIEWS = 0.3
"""Share of all cameras, and three at least, that must doubt a place: next to a camera a few agree on anything."""
APART = 6.0
"""Sizes of a new point that it must lie away from what moves already, to be there by doubts."""
DEPTHS = 64
CLOSE = 8
"""What is nearer than this part of the depth behind it would fill the view: no place is tried there."""
RAYS = 4000


@dataclass(frozen=True)
class Found:
    """points: [M, 3] world; colors: [M, 3] 0..1; sizes: [M] world, standard deviation, half the distance to the next point."""

    points: np.ndarray
    colors: np.ndarray
    sizes: np.ndarray

    def rows(self, index: np.ndarray) -> Found:
        return Found(self.points[index], self.colors[index], self.sizes[index])

    def and_those(self, other: Found) -> Found:
        pairs = (self.points, other.points), (self.colors, other.colors), (self.sizes, other.sizes)
        return Found(*(np.concatenate(pair) for pair in pairs))


class Faults(NamedTuple):
    """Where pictures differ from their truths. wrong: [..., H, W] bool, by more than noise and edges do; doubtful: at least a little.

    A thing stands out before one wall and hardly before another, and one that is a pixel wide is an edge in itself. So what is wrong
    in a few views may be borne out by others that merely doubt it.
    """

    wrong: np.ndarray
    doubtful: np.ndarray


def faults(image: np.ndarray, truth: np.ndarray) -> Faults:
    """Of a picture [H, W, 3] float against its truth (uint8)."""
    error = np.abs(image - truth.astype(np.float32) / 255).mean(-1)
    smooth = cv2.GaussianBlur(error, (5, 5), 1.2)
    mask = cv2.morphologyEx((smooth > WRONG).astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    return Faults(mask > 0, smooth > DOUBT)


def find(
    cameras: list[Camera],
    images: np.ndarray,
    faulty: Faults,
    depths: np.ndarray,
    near: float,
    moving: np.ndarray,
    seed: int = 0,
) -> Found:
    """Points of what is missing in the views.

    images: [C, H, W, 3] uint8; faulty: of all views; depths: [C, H, W] what the scene without it shows, infinite for nothing.
    moving: [N, 3] the keyframe's dynamic points, where they are now. Close to them doubts do not count: they are off a little, which
    training mends.
    """
    rays = _rays(faulty.wrong, np.random.default_rng(seed))
    if len(rays) == 0:
        return Found(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32), np.zeros(0, np.float32))
    places, footprint, stride = _places(cameras, rays, faulty.wrong, depths, near)
    own = images[rays[:, 0], rays[:, 1], rays[:, 2]].astype(np.float32) / 255
    poses, lenses = np.stack([c.viewmat for c in cameras]), np.stack([c.K for c in cameras])
    least = max(3, VIEWS * len(cameras))
    found = []
    for support in faulty:
        score = carve.disagreement(places, own, poses, lenses, images, support, depths, near, least, AGREE)
        best = score.argmin(1)
        good = np.flatnonzero(score.min(1) < COLOR)
        sizes = 0.5 * footprint[good, best[good]] * stride
        found.append(Found(places[good, best[good]], own[good], sizes))
    sure, doubtful = found
    return _thinned(sure.and_those(_apart(doubtful, moving)))


def _apart(found: Found, moving: np.ndarray) -> Found:
    """What lies away from points [N, 3]."""
    if len(moving) == 0 or len(found.points) == 0:
        return found
    distance = KDTree(moving).query(found.points)[0]
    return found.rows(np.flatnonzero(distance > APART * found.sizes))


def _rays(wrong: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """[R, 3] camera, row, column of wrong pixels, an even choice of them."""
    rays = np.argwhere(wrong)
    return rays if len(rays) <= RAYS else rays[np.sort(rng.choice(len(rays), RAYS, replace=False))]


def _places(
    cameras: list[Camera], rays: np.ndarray, wrong: np.ndarray, depths: np.ndarray, near: float
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
    stride = float(np.sqrt(max(wrong.sum() / len(rays), 1.0)))
    return places.astype(np.float32), (z / K[:, 0, 0][:, None]).astype(np.float32), stride


def _thinned(found: Found) -> Found:
    """One point a cell, a little finer than their spacing."""
    if len(found.points) == 0:
        return found
    cell = 1.5 * float(np.median(found.sizes))
    _, first = np.unique(np.floor(found.points / cell).astype(np.int64), axis=0, return_index=True)
    return found.rows(first)
