"""Smooth decisions: neighboring pixels of the same color belong together, specks and small holes do not exist."""

from __future__ import annotations

import cv2
import numpy as np

RADIUS = 6
"""Radius of the neighborhood, in pixels of an image 320 wide."""
EDGE = 5e-4
"""Variance of colors, 0..1, from which on a border within the neighborhood counts."""
COUPLING, ROUNDS = 6.0, 4
"""Weight of the neighborhood, as log odds, and the number of rounds in which decisions spread."""
SPECK, HOLE = 0.0003, 0.002
"""Largest area of a speck and of a hole, as a share of the image."""


class GuidedFilter:
    """Filter that follows the borders of an image.

    Args:
        image: [H, W, 3] uint8.

    Source:
        He et al. 2010, Guided Image Filtering, equations 14 and 15.
    """

    def __init__(self, image: np.ndarray) -> None:
        self._radius = max(1, round(RADIUS * image.shape[1] / 320))
        self._image = image.astype(np.float32) / 255
        self._mean = self._box(self._image)
        products = self._image[..., :, None] * self._image[..., None, :]
        variance = self._box(products.reshape(*image.shape[:2], 9)).reshape(*image.shape[:2], 3, 3)
        variance -= self._mean[..., :, None] * self._mean[..., None, :]
        self._inverse = np.linalg.inv(variance + EDGE * np.eye(3, dtype=np.float32))

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Return filtered values [H, W] float32."""
        mean = self._box(values)
        covariance = self._box(self._image * values[..., None]) - self._mean * mean[..., None]
        slope = (self._inverse @ covariance[..., None])[..., 0]
        offset = mean - (slope * self._mean).sum(-1)
        return (self._box(slope) * self._image).sum(-1) + self._box(offset)

    def _box(self, values: np.ndarray) -> np.ndarray:
        size = 2 * self._radius + 1
        if values.ndim == 2 or values.shape[2] <= 4:
            return cv2.boxFilter(values, -1, (size, size))
        return np.stack([cv2.boxFilter(values[..., k], -1, (size, size)) for k in range(values.shape[2])], -1)


def decide(image: np.ndarray, odds: np.ndarray) -> np.ndarray:
    """Return decisions [H, W] float32, from -1 (background) to 1 (subject), that follow the borders of the image.

    Each round replaces the decision of a pixel by its own log odds and the mean decision of similar neighbors.

    Args:
        image: [H, W, 3] uint8.
        odds: [H, W] float32, log odds of the subject.
    """
    filtered, decision = GuidedFilter(image), np.tanh(odds / 2)
    for _ in range(ROUNDS):
        decision = np.tanh((odds + COUPLING * filtered(decision)) / 2)
    return decision


def without_specks(mask: np.ndarray, support: np.ndarray) -> np.ndarray:
    """Return a mask [H, W] bool with small holes filled where other views support the subject, and without specks.

    Args:
        mask: [H, W] bool.
        support: [H, W], positive where other views support the subject.
    """
    out = mask.copy()
    for inside, largest in ((~mask, HOLE), (mask, SPECK)):
        connectivity = 4 if inside is not mask else 8
        count, parts, stats, _ = cv2.connectedComponentsWithStats(inside.astype(np.uint8), connectivity=connectivity)
        parts = np.asarray(parts, np.int64)
        supported = np.bincount(parts.ravel(), (support > 0).ravel(), count)
        area = stats[:, cv2.CC_STAT_AREA]
        flipped = area < largest * mask.size
        if inside is not mask:
            flipped &= supported > 0.7 * area
        flipped[0] = False
        out ^= flipped[parts]
    return out
