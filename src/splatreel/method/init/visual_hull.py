"""Visual hull of a subject: the places that all cameras show within its masks."""

from __future__ import annotations

import copy

import cv2
import numpy as np

from splatreel.capture.masks import UNLIKELY
from splatreel.scene.camera import Camera, angles_apart, focus_point
from splatreel.scene.volumes import in_image

AGREEING = 0.9
"""Share of the cameras that see a place, rounded up, whose masks must contain it. One bad mask among ten removes nothing."""
MOST_DOUBTS = 0.3
"""Largest share of the cameras that see a place that may show it by unlikely pixels. One camera always may."""
MARGIN = 1 / 120
"""Width by which masks are dilated, as a share of the image width. Edges of masks are uncertain by a pixel or two."""
DARKEST = 64
"""Gray level above which a pixel of a mask belongs to the subject."""

OPAQUE = 250
"""Opacity above which a pixel shows nothing of the background."""
WIDE = 30.0
"""Median angle between neighboring cameras, degrees, above which a rig is sparse (docs/experiments/2026-11-27-few-cameras.md).
Between denser cameras other views contradict points that do not belong to the subject."""


def is_sparse(cameras: list[Camera]) -> bool:
    """Return True if a subject before these training cameras needs more than their images: what surrounds it must stay empty.

    A point that a single camera sees, outside of that camera's mask, may have the color of its background. Nothing contradicts
    the point if it is beyond the borders of all other images.
    """
    return len(cameras) > 1 and bool(np.median(angles_apart(cameras, focus_point(cameras)).min(1)) >= WIDE)


def without_background(images: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Return images [C, H, W, 3] uint8 whose pixels outside of the masks [C, H, W] uint8 have the color of the nearest one inside.

    The first points then have colors of the subject, never those of a background.
    """
    found = images.copy()
    for image, opacity in zip(found, alpha, strict=True):
        outside = (opacity < OPAQUE).astype(np.uint8)
        if outside.all():
            continue
        _, labels = cv2.distanceTransformWithLabels(outside, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
        colors = np.zeros((labels.max() + 1, 3), np.uint8)
        colors[labels[outside == 0]] = image[outside == 0]
        image[:] = colors[labels]
    return found


class VisualHull:
    """Places within the masks of the cameras that see them. Places that no camera sees are outside.

    Pixels in doubt are within the masks. But if they are unlikely, only in one camera for each place, or in `MOST_DOUBTS` of those that
    see it. Otherwise hardly any camera would decide about the place.
    """

    def __init__(self, cameras: list[Camera], masks: np.ndarray, near: float = 0.0) -> None:
        self.cameras = cameras
        self.near = near
        size = 2 * max(1, round(MARGIN * masks.shape[2])) + 1
        kernel = np.ones((size, size), np.uint8)
        shown = [mask >= DARKEST for mask in masks]
        likely = [inside & (mask != UNLIKELY) for inside, mask in zip(shown, masks, strict=True)]
        self._masks = [
            np.add(*[cv2.dilate(inside.astype(np.uint8), kernel) for inside in pair])
            for pair in zip(shown, likely, strict=True)
        ]
        """[H, W] uint8 of each camera: 0 outside, 1 within by unlikely pixels, 2 within."""

    def of(self, cameras: list[Camera], masks: list[int]) -> VisualHull:
        """Return the hull of some of the masks, by number, at the given cameras."""
        hull = copy.copy(self)
        hull.cameras, hull._masks = cameras, [self._masks[number] for number in masks]
        return hull

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Return which points [..., 3] are inside, [...] bool."""
        seen, within, unlikely = np.zeros((3, *points.shape[:-1]), np.int64)
        for camera, mask in zip(self.cameras, self._masks, strict=True):
            inside, pixels, _ = in_image(points, camera, self.near)
            column, row = np.where(inside[..., None], pixels, 0).astype(np.int64).reshape(-1, 2).T
            seen += inside
            level = mask[row, column].reshape(inside.shape)
            within += inside & (level > 0)
            unlikely += inside & (level == 1)
        return (seen > 0) & (within >= np.ceil(AGREEING * seen)) & (unlikely <= np.maximum(MOST_DOUBTS * seen, 1))

    def bounds(self) -> None:
        """Return None: the hull has no simple box."""
        return
