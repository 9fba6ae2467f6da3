"""Evidence of one image that its pixels show the subject: differences from the background in color and structure."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from splatreel.segmentation.background import SATURATED, Background, largest_channel

LIMIT = 3.0
"""Largest evidence of a pixel, as log odds."""
UNSURE = 3.0
"""Difference from the background, in standard deviations, at which a pixel is as likely of the subject as of the background."""
MIN_FLOOR, MAX_FLOOR = 2.0, 5.0
"""Smallest and largest standard deviation of small changes of light, gray levels. It adds to the noise."""
MEASURED = 6
"""Number of samples in which changes of light are measured."""
HUE_FLOOR = 2.0
"""The same for differences that are left after the brightness is fitted, gray levels."""
DARKEST_SHADOW = 0.5
"""Smallest brightness of a shadow, as a share of the background's."""
SHADOW_ODDS = -0.75
"""Evidence of a pixel that looks like the background in a shadow. Other cameras overrule it where they see a body."""
SHADOW_EDGE = 3.0
"""Change of brightness between neighboring pixels of a soft shadow, gray levels. It adds to the noise."""
DIMMED = 0.9
"""Factor of light below which a saturated background has no known color."""
BLUR = 0.7
"""Standard deviation of the filter that reduces noise before images are compared, pixels."""


def subject_evidence(frame: np.ndarray, background: Background) -> np.ndarray:
    """Return log odds [H, W] float32 that pixels show the subject, -LIMIT..LIMIT. They are 0 where the background is unknown.

    Args:
        frame: [H, W, 3] uint8.
        background: Background of the camera.
    """
    seen, behind = _compared(frame, background)
    difference = largest_channel(np.abs(seen - behind)) / np.hypot(background.noise, background.floor)
    found = np.clip(difference / UNSURE - 1, -1, 1) * LIMIT
    shadow = _shadow_likeness(seen, behind, np.hypot(background.noise, HUE_FLOOR))
    found = np.where(found > SHADOW_ODDS, found + (SHADOW_ODDS - found) * shadow, found)
    # A background that is too bright for the camera has no known color in less light.
    bright = largest_channel(background.image)
    unknown = ~background.known | ((bright >= SATURATED) & (largest_channel(behind) < DIMMED * bright))
    return np.where(unknown, 0, found).astype(np.float32)


def difference(frame: np.ndarray, background: Background) -> np.ndarray:
    """Return the difference [H, W] float32 of a frame [H, W, 3] uint8 from the background, gray levels.

    It is infinite where the background is unknown.
    """
    seen, behind = _compared(frame, background)
    return np.where(background.known, largest_channel(np.abs(seen - behind)), np.float32(np.inf))


def with_floor(background: Background, samples: np.ndarray) -> Background:
    """Return the background with the changes of light that samples [S, H, W, 3] uint8 show where nothing moves.

    In a studio these changes are small, so that a shirt is told from a wall of almost the same color.
    """
    chosen = np.unique(np.linspace(0, len(samples) - 1, MEASURED).round().astype(int))
    differences = np.stack([difference(samples[number], background) for number in chosen])
    still = differences[differences < UNSURE * np.hypot(background.noise, MAX_FLOOR)]
    deviation = np.percentile(still, 90) / 1.645 if still.size else MAX_FLOOR
    return replace(background, floor=float(np.clip(deviation, MIN_FLOOR, MAX_FLOOR)))


def _compared(frame: np.ndarray, background: Background) -> tuple[np.ndarray, np.ndarray]:
    """Return a frame and the background in its light, [H, W, 3] float32 each, with less noise."""
    seen = cv2.GaussianBlur(frame.astype(np.float32), (0, 0), BLUR)
    return seen, cv2.GaussianBlur(background.lit(frame), (0, 0), BLUR)


def _shadow_likeness(seen: np.ndarray, behind: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Return [H, W], 0..1, how well a darker background explains the pixels: the same hue and the same structure.

    Within a shadow, the ratio to the background changes slowly. On cloth and at borders of bodies it changes quickly.
    """
    ratio = (seen * behind).sum(-1) / np.maximum((behind * behind).sum(-1), 1)
    hue = largest_channel(np.abs(seen - ratio[..., None] * behind)) / noise
    likely = np.clip(2 - hue / UNSURE, 0, 1) * (ratio > DARKEST_SHADOW) * (ratio < 1)
    texture = cv2.morphologyEx(ratio, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) * behind.mean(-1)
    texture = texture / np.hypot(noise, SHADOW_EDGE)
    return likely * np.clip(2 - texture / UNSURE, 0, 1)
