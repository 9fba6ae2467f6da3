"""Smooth decisions: neighboring pixels of the same color belong together, specks and small holes do not exist."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from splatreel.capture.masks import LIKELY_GRAY, UNLIKELY_GRAY

Row = tuple[np.ndarray, np.ndarray, np.ndarray]
Rows = tuple[Row, Row, Row]
"""Rows of a 3 x 3 matrix, whose elements are images [H, W]."""

RADIUS = 6
"""Radius of the neighborhood, in pixels of an image 320 wide."""
EDGE = 5e-4
"""Smallest variance of colors, 0..1, at which a border within the neighborhood counts."""
COUPLING, ROUNDS = 6.0, 4
"""Weight of the neighborhood, as log odds, and the number of rounds in which decisions spread."""
SPECK, HOLE = 0.0003, 0.002
"""Largest area of a speck and of a hole, as a share of the image."""
SUPPORTED, FIRM = 0.3, 1.0
"""Smallest share of a part of the mask that other views must support, and log odds of that support. Reflections have none."""
NEARBY = 8.0
"""Largest distance from the mask of a pixel outside that is in doubt, in pixels of an image 320 wide."""
LIKE_BACKGROUND = -1.0
"""Evidence of the image alone below which a pixel within the mask is in doubt: it looks like the background."""
UNLIKE_BACKGROUND = -2.0
"""Evidence of the image alone above which a pixel outside of the mask is in doubt, if other views see the subject there."""


class GuidedFilter:
    """Filter that follows the borders of an image.

    Args:
        image: [H, W, 3] uint8.

    Source:
        He et al. 2010, Guided Image Filtering, equations 14 and 15.
    """

    def __init__(self, image: np.ndarray) -> None:
        self._radius = max(1, round(RADIUS * image.shape[1] / 320))
        self._image = [np.float32(1 / 255) * image[..., k].astype(np.float32) for k in range(3)]
        self._means = [self._box(channel) for channel in self._image]
        pairs = [(j, k) for j in range(3) for k in range(j, 3)]
        xx, xy, xz, yy, yz, zz = (
            self._box(self._image[j] * self._image[k]) - self._means[j] * self._means[k] for j, k in pairs
        )
        self._inverse = _inverse(xx + EDGE, xy, xz, yy + EDGE, yz, zz + EDGE)

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Return filtered values [H, W] float32."""
        mean = self._box(values)
        channels = list(zip(self._image, self._means, strict=True))
        covariances = [self._box(channel * values) - center * mean for channel, center in channels]
        slopes = [_weighted_sum(row, covariances) for row in self._inverse]
        offset = mean - _weighted_sum(slopes, self._means)
        return _weighted_sum([self._box(slope) for slope in slopes], self._image) + self._box(offset)

    def _box(self, values: np.ndarray) -> np.ndarray:
        size = 2 * self._radius + 1
        return cv2.boxFilter(values, -1, (size, size))


def _weighted_sum(weights: Sequence[np.ndarray], values: Sequence[np.ndarray]) -> np.ndarray:
    (a, b, c), (x, y, z) = weights, values
    return a * x + b * y + c * z


def _inverse(xx: np.ndarray, xy: np.ndarray, xz: np.ndarray, yy: np.ndarray, yz: np.ndarray, zz: np.ndarray) -> Rows:
    """Return the rows of the inverse of a symmetric 3 x 3 matrix per pixel."""
    a, b, c = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    d, e, f = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    scale = 1 / (xx * a + xy * b + xz * c)
    a, b, c, d, e, f = (scale * cofactor for cofactor in (a, b, c, d, e, f))
    return (a, b, c), (b, d, e), (c, e, f)


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
    """Return a mask [H, W] bool with small holes filled where other views support the subject, and without stray parts.

    Stray parts are specks, and parts that no other view supports. What one camera alone shows has no known place anyway.

    Args:
        mask: [H, W] bool.
        support: [H, W], positive where other views support the subject.
    """
    out = mask.copy()
    for inside, largest in ((~mask, HOLE), (mask, SPECK)):
        connectivity = 4 if inside is not mask else 8
        count, parts, stats, _ = cv2.connectedComponentsWithStats(inside.astype(np.uint8), connectivity=connectivity)
        parts = np.asarray(parts, np.int64)
        supported = np.bincount(parts.ravel(), (support > (FIRM if inside is mask else 0)).ravel(), count)
        area = stats[:, cv2.CC_STAT_AREA]
        flipped = area < largest * mask.size
        if inside is mask:
            flipped |= supported < SUPPORTED * area
        else:
            flipped &= supported > 0.7 * area
        flipped[0] = False
        out ^= flipped[parts]
    return out


def with_doubts(mask: np.ndarray, own: np.ndarray, support: np.ndarray) -> np.ndarray:
    """Return a mask [H, W] bool as gray levels [H, W] uint8, with pixels in doubt.

    A shirt may have the color of the wall behind it. The image alone cannot tell it from the wall then. Other views can.

    Args:
        mask: [H, W] bool.
        own: [H, W] float32, log odds of the subject by this image alone.
        support: [H, W] float32, log odds of the subject by other views.
    """
    reach = NEARBY * mask.shape[1] / 320
    near = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 5) <= reach
    found = np.where(mask, np.uint8(255), np.uint8(0))
    found[_broad(mask & (own < LIKE_BACKGROUND))] = LIKELY_GRAY
    unlikely = _broad(~mask & near & (support > 0) & (own > UNLIKE_BACKGROUND))
    unlikely |= without_specks(mask | unlikely, support) & ~mask
    found[unlikely] = UNLIKELY_GRAY
    return found


def _broad(pixels: np.ndarray) -> np.ndarray:
    """Return pixels [H, W] bool without thin parts, such as mixed pixels along borders: those near places three pixels wide."""
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    core = cv2.erode(pixels.astype(np.uint8), cross, borderValue=1)
    return pixels & (cv2.dilate(core, cross, iterations=3) > 0)


def without_halo(mask: np.ndarray, difference: np.ndarray) -> np.ndarray:
    """Return a mask [H, W] bool without border pixels that show more of the background than of the subject.

    A pixel on the border mixes both. It differs from the background by less than half of what its neighbors within the mask do.

    Args:
        mask: [H, W] bool.
        difference: [H, W] float32, difference from the background, infinite where the background is unknown.
    """
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    border = mask & (cv2.erode(mask.astype(np.uint8), cross, borderValue=1) == 0)
    strongest = cv2.dilate(
        np.where(mask & np.isfinite(difference), difference, np.float32(0)), np.ones((3, 3), np.uint8)
    )
    return mask & ~(border & (difference < 0.5 * strongest))
