"""Depths of single pixels that several training views agree on, searched along the pixels' rays.

The rendered depth of a plain wall is often wrong where a dot is missing. A point at this depth draws the dot correctly in its own
view only. A patch around the pixel is therefore compared with the neighboring views at several depths. The patch keeps the
slope of the rendered surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from splatreel.method.init.planesweep import NOISE
from splatreel.method.init.triangulate import nearest_poses
from splatreel.method.train.training_images import TrainingImages

NEIGHBORS = 4
"""Views that a patch is compared with. The best two count, since others may be occluded."""
PATCH = 5
"""Width of a patch, pixels."""
STEPS, STEP_PIXELS = 8, 0.5
"""Depths in front of the rendered one, and as many behind it; their distance in the median neighboring view, pixels."""
LARGEST_STEP = 0.03
"""Largest distance of two depths, as a share of the rendered inverse depth."""
STEP_COST = 0.03
"""Correlation that a step away from the rendered depth must gain."""
MIN_GAIN, MIN_CORRELATION = 0.1, 0.4
"""A depth replaces the rendered one if its correlation is larger by `MIN_GAIN`, and at least `MIN_CORRELATION`. Measured in
docs/experiments/2026-11-27-plain-walls.md."""
BATCH = 4096
"""Pixels that are searched together. It bounds the memory; OpenCV samples at most 32767 rows at once."""
SMOOTHING = 1.5
"""Standard deviation, pixels, of the filter of inverse depths. The slope of a patch follows from the result."""


@dataclass(frozen=True)
class _Relation:
    """Pose of another view relative to the reference view.

    Attributes:
        rotation: [3, 3] reference to other.
        translation: [3] reference to other, world units.
        K: [3, 3] intrinsics of the other view, pixels.
        gray: [H, W] float32 image of the other view, 0..1; NaN where it is unknown.
    """

    rotation: np.ndarray
    translation: np.ndarray
    K: np.ndarray
    gray: np.ndarray

    def pixels(self, rays: np.ndarray, inverse: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the columns and rows [M, D, P] of points, with pixel centers at integers; NaN behind the view.

        Args:
            rays: [M, P, 3] directions in the reference view, with z = 1.
            inverse: [M, D, P] inverse depths.
        """
        x, y, z = ((rays @ self.rotation[axis])[:, None] + self.translation[axis] * inverse for axis in range(3))
        z = np.where(z > 1e-6, z, np.nan)
        return x / z * self.K[0, 0] + self.K[0, 2] - 0.5, y / z * self.K[1, 1] + self.K[1, 2] - 0.5

    def correlation(self, patches: np.ndarray, rays: np.ndarray, inverse: np.ndarray) -> np.ndarray:
        """Return the correlation [M, D] of patches [M, P] with this view at inverse depths [M, D, P]; NaN outside of the image."""
        column, row = self.pixels(rays, inverse)
        height, width = self.gray.shape
        seen = ((column >= 0) & (column <= width - 1) & (row >= 0) & (row <= height - 1)).all(-1)
        x, y = (np.where(seen[..., None], at, 0).reshape(len(at), -1).astype(np.float32) for at in (column, row))
        found = cv2.remap(self.gray, x, y, cv2.INTER_LINEAR).reshape(column.shape)
        return np.where(seen, _correlate(patches[:, None], found), np.nan)


class RayDepths:
    """Search for depths in the training images of one frame."""

    def __init__(self, images: TrainingImages) -> None:
        """Prepare the images.

        Args:
            images: Training images of a keyframe.
        """
        self.views = images.views
        self.near = images.near
        self.poses = [view.viewmat.astype(np.float64) for view in self.views]
        self.intrinsics = [view.K.astype(np.float64) for view in self.views]
        self.grays = [cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32) / 255 for image in images.pixels[0]]
        if images.unknown is not None:
            for gray, unknown in zip(self.grays, images.unknown[0], strict=True):
                gray[unknown] = np.nan
        centers = np.stack([view.center for view in self.views])
        self.nearest = nearest_poses(centers, np.stack([pose[2, :3] for pose in self.poses]), NEIGHBORS)

    def agreed(self, camera: int, pixels: np.ndarray, depth: np.ndarray, known: np.ndarray) -> np.ndarray:
        """Return the depths [M] of pixels: those that other views agree on, else the rendered ones.

        Args:
            camera: Number of the view.
            pixels: [M] row-major numbers of the pixels.
            depth: [H, W] rendered depth, world units.
            known: [H, W] bool, pixels with a rendered depth.
        """
        rendered = depth.ravel()[pixels].astype(np.float64)
        if len(self.nearest[camera]) < 2:
            return rendered
        surface = _smoothed(1 / depth.astype(np.float64), known)
        for start in range(0, len(pixels), BATCH):
            batch = slice(start, start + BATCH)
            found = self._found(camera, pixels[batch], surface)
            rendered[batch] = np.where(np.isnan(found), rendered[batch], found)
        return rendered

    def _found(self, camera: int, pixels: np.ndarray, surface: np.ndarray) -> np.ndarray:
        """Return the depths [M] that other views agree on; NaN where the rendered one is kept. surface: [H, W] inverse depths."""
        row, column, rays = self._patches(camera, pixels)
        inverse = surface[row, column]
        middle = inverse[:, PATCH**2 // 2]
        others = [self._relation(camera, other) for other in self.nearest[camera]]
        shifts = np.arange(-STEPS, STEPS + 1)
        tried = middle[:, None] + shifts * _steps(others, rays[:, PATCH**2 // 2], middle)[:, None]
        tried = np.minimum(tried, 1 / self.near)
        surfaces = np.maximum(tried[..., None] + (inverse - middle[:, None])[:, None], 0)
        patches = self.grays[camera][row, column]
        scores = np.stack([other.correlation(patches, rays, surfaces) for other in others])
        scores = -np.sort(-np.where(np.isnan(scores), -np.inf, scores), axis=0)[:2].mean(0)
        best = np.argmax(scores - STEP_COST * np.abs(shifts), 1)
        found = scores[np.arange(len(best)), best]
        better = (found > MIN_CORRELATION) & (found > np.maximum(scores[:, STEPS], -1) + MIN_GAIN)
        return np.where(better, 1 / tried[np.arange(len(best)), best], np.nan)

    def _patches(self, camera: int, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the rows and columns [M, P] of the patches around pixels [M], and their rays [M, P, 3] with z = 1."""
        view, K, radius = self.views[camera], self.intrinsics[camera], PATCH // 2
        down, across = np.mgrid[-radius : radius + 1, -radius : radius + 1].reshape(2, -1)
        row = np.clip((pixels // view.width)[:, None] + down, 0, view.height - 1)
        column = np.clip((pixels % view.width)[:, None] + across, 0, view.width - 1)
        x, y = (column + 0.5 - K[0, 2]) / K[0, 0], (row + 0.5 - K[1, 2]) / K[1, 1]
        return row, column, np.stack([x, y, np.ones_like(x)], -1)

    def _relation(self, camera: int, other: int) -> _Relation:
        relative = self.poses[other] @ np.linalg.inv(self.poses[camera])
        return _Relation(relative[:3, :3], relative[:3, 3], self.intrinsics[other], self.grays[other])


def _steps(others: list[_Relation], rays: np.ndarray, inverse: np.ndarray) -> np.ndarray:
    """Return the distance [M] of two inverse depths that moves pixels [M] by `STEP_PIXELS` in the median other view.

    Args:
        others: Other views.
        rays: [M, 3] directions of the pixels.
        inverse: [M] inverse depths.
    """
    nearby = np.stack([inverse, 1.01 * inverse], 1)[..., None]
    moved = [np.hypot(*(at[:, 1, 0] - at[:, 0, 0] for at in other.pixels(rays[:, None], nearby))) for other in others]
    moved = np.stack(moved)
    median = np.median(np.where(np.isnan(moved), 0, moved), axis=0)
    return np.minimum(STEP_PIXELS * 0.01 / np.maximum(median, 1e-9), LARGEST_STEP) * inverse


def _smoothed(inverse: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return inverse depths [H, W], averaged over the known pixels around each pixel; unchanged where none is known."""
    weight = cv2.GaussianBlur(known.astype(np.float64), (0, 0), SMOOTHING)
    total = cv2.GaussianBlur(np.where(known, inverse, 0), (0, 0), SMOOTHING)
    return np.where(weight > 1e-6, total / np.maximum(weight, 1e-6), inverse)


def _correlate(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the zero-mean normalized correlation of patches over their last axis. Flat patches have none."""
    a, b = a - a.mean(-1, keepdims=True), b - b.mean(-1, keepdims=True)
    power = (np.square(a).mean(-1) + NOISE**2) * (np.square(b).mean(-1) + NOISE**2)
    return (a * b).mean(-1) / np.sqrt(power)
