"""Backgrounds of pixels that the subject covers most of the time."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from splatreel.segmentation.background import MIN_SAMPLES, Background, fit_background, largest_channel
from splatreel.segmentation.colors import ColorModel

DIFFERENT = 15.0
"""Smallest difference of the second color of a pixel from the first, gray levels."""
MARGIN = 1.0
"""Log odds by which the first color must be more likely the subject's than the second color is."""
AREA = 5
"""Side of the square over which these log odds are averaged, pixels."""
REACH = 11
"""Side of the square, pixels, in which colors on both sides of a border are compared."""


def uncover(background: Background, samples: np.ndarray, colors: ColorModel) -> tuple[Background, np.ndarray]:
    """Find the background where the subject covers it in most samples.

    The most frequent color of a pixel may be that of somebody who stands there for most of the video. Their moving parts have taught
    the colors of the subject. If the first color is the subject's, and the second one is not, the second is the background, provided
    that it continues the background around it better than the first color does.

    Args:
        background: Background by the most frequent colors.
        samples: [S, H, W, 3] uint8.
        colors: Colors of the subject and of its surroundings.

    Returns:
        The background, and the pixels [H, W] bool that changed.
    """
    away = largest_channel(np.abs(samples.astype(np.float32) - background.image)) > DIFFERENT
    second = fit_background(samples, away.astype(np.float32))
    often = second.share > (MIN_SAMPLES - 0.5) / len(samples)
    differs = largest_channel(np.abs(second.image - background.image)) > DIFFERENT
    first_odds, second_odds = (_mean_odds(colors, image) for image in (background.image, second.image))
    taken = often & differs & (first_odds > 0) & (first_odds - second_odds > MARGIN)
    taken = cv2.morphologyEx(taken.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)) > 0
    taken = _continuing(taken, background.image, second.image)
    found = replace(
        background,
        image=np.where(taken[..., None], second.image, background.image),
        noise=np.where(taken, second.noise, background.noise),
        share=np.where(taken, second.share, background.share),
        known=background.known | taken,
    )
    return found, taken


def _continuing(taken: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the parts of `taken` [H, W] bool in which a second image continues what is around better than the first does.

    Args:
        taken: [H, W] bool.
        first: [H, W, 3] float32, the image around, and within.
        second: [H, W, 3] float32, the other image within.
    """
    count, parts = cv2.connectedComponents(taken.astype(np.uint8))
    inside, square = taken.astype(np.float32), np.ones((REACH, REACH), np.uint8)
    weight = cv2.blur(inside, (REACH, REACH))
    mixed = cv2.dilate(inside, np.ones((3, 3), np.uint8)) > 0  # borders mix colors
    around = ~mixed & (cv2.dilate(inside, square) > 0)
    part = cv2.dilate(parts.astype(np.float32), square)[around].astype(np.int64)
    errors = []
    for image in (first, second):
        mean = cv2.blur(image * inside[..., None], (REACH, REACH))[around] / weight[around][:, None]
        errors.append(np.bincount(part, np.abs(mean - first[around]).max(-1), count))
    better = errors[1] < errors[0]
    return taken & better[np.asarray(parts)]


def _mean_odds(colors: ColorModel, image: np.ndarray) -> np.ndarray:
    """Return the log odds [H, W] of the subject by the colors of an image [H, W, 3] float32, averaged over small squares."""
    return cv2.blur(colors.evidence(np.clip(image, 0, 255).astype(np.uint8)), (AREA, AREA))
