"""Check of poses by the masks of a subject: the mask of each camera must fit the visual hull of the others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from splatreel.capture.base import MIN_CAMERAS
from splatreel.capture.masked_capture import LIKELY
from splatreel.method.init.visual_hull import VisualHull
from splatreel.scene.camera import Camera

RAYS, STEPS = 400, 96
"""Number of pixels of each mask that are examined, and of places on the ray of each."""
SMALLEST = 0.1
"""Smallest size of a mask, as a share of the median. With a wrong pose, masks without weights keep only a small part that fits."""
NEAREST, FARTHEST = 0.1, 1.9
"""Ends of the rays, as shares of the camera's distance from the focus."""


def mask_fits(cameras: Sequence[Camera], masks: np.ndarray, focus: np.ndarray, near: float) -> list[float]:
    """Return the share of each camera's mask, 0..1, whose pixels show a place within the hull of the other masks.

    With right poses it is 1 but for errors of the masks. One pose that is wrong by ten degrees has 0.4 to 0.8 in the worst camera.

    Args:
        cameras: C cameras.
        masks: [C, H, W] uint8, opacity of the subject at one moment.
        focus: [3] world, middle of the scene.
        near: Smallest depth, world units.

    Returns:
        C shares. A mask smaller than `SMALLEST` of the median confirms nothing and has 0. So has each of fewer than three: two masks
        fit for most poses.
    """
    sizes = (masks >= LIKELY).sum((1, 2))
    found = [0.0] * len(cameras)
    if len(cameras) < MIN_CAMERAS:
        return found
    for c in np.flatnonzero(sizes > SMALLEST * np.median(sizes)).tolist():
        others = [other for other in range(len(cameras)) if other != c]
        hull = VisualHull([cameras[other] for other in others], masks[others], near)
        found[c] = float(hull.contains(_places(cameras[c], masks[c], focus, near)).any(1).mean())
    return found


def _places(camera: Camera, mask: np.ndarray, focus: np.ndarray, near: float) -> np.ndarray:
    """Return places [R, STEPS, 3] on the rays of pixels of a mask."""
    rows, columns = np.nonzero(mask >= LIKELY)
    chosen = np.linspace(0, len(rows) - 1, min(RAYS, len(rows))).round().astype(int)
    pixels = np.stack([columns[chosen] + 0.5, rows[chosen] + 0.5, np.ones(len(chosen))], -1)
    directions = pixels @ np.linalg.inv(camera.K).T @ camera.viewmat[:3, :3]
    distance = float(np.linalg.norm(camera.center - focus))
    depths = np.linspace(max(near, NEAREST * distance), FARTHEST * distance, STEPS)
    return camera.center + directions[:, None] * depths[:, None]
