"""Opacity of the subject in border pixels, which mix it with a known background."""

from __future__ import annotations

import cv2
import numpy as np

from splatreel.capture.masks import inner_colors, level_of_opacity
from splatreel.segmentation.background import Background

SUBJECT_NOISE = 8.0
"""Standard deviation of the subject's color between a border pixel and its neighbors inside, gray levels."""
PRIOR_BLUR, PRIOR_DEVIATION = 0.5, 0.3
"""Standard deviation of the filter by which the mask alone tells opacities, in pixels, and standard deviation of these opacities."""


def with_border_opacity(mask: np.ndarray, frame: np.ndarray, background: Background) -> np.ndarray:
    """Return a mask whose border, one pixel on each side, tells how much of each pixel the subject fills.

    A border pixel has the color C = a F + (1 - a) B. F is the color of its neighbors inside, and B is the background. The opacity a is
    the least squares solution, weighted by the noise of both colors. Where F is like B, the mask alone decides.

    Args:
        mask: [H, W] uint8 gray levels of `with_doubts`. Pixels in doubt stay as they are, and so do those without a known background.
        frame: [H, W, 3] uint8.
        background: Background of the camera.
    """
    shown = (mask > 127).astype(np.uint8)
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    certain = (mask == 0) | (mask == 255)
    inside = (cv2.erode(shown, cross, borderValue=1) > 0) & certain
    border = (cv2.dilate(shown, cross) > 0) & ~inside & certain & background.known
    subject, near = inner_colors(frame, inside, border)
    behind = background.lit(frame)[border]
    noise = np.square(background.noise[border]) + background.floor**2 + SUBJECT_NOISE**2
    expected = cv2.GaussianBlur(shown.astype(np.float32), (0, 0), PRIOR_BLUR)[border]
    contrast, seen = subject - behind, frame[border] - behind
    weight = 1 / PRIOR_DEVIATION**2
    opacity = ((seen * contrast).sum(1) / noise + weight * expected) / (np.square(contrast).sum(1) / noise + weight)
    found = mask.copy()
    levels = level_of_opacity((255 * opacity).clip(0, 255).round().astype(np.uint8))
    found[border] = np.where(near, levels, mask[border])
    return found
