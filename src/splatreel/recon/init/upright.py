"""Up direction of a scene. People hold cameras level, whether they look up or down."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from splatreel.scene.camera import Camera

ROLL_SCALES = [math.sin(math.radians(angle)) for angle in (45, 30, 20, 12, 12, 12, 12)]
"""Sine of the roll at which a camera's weight falls, per iteration. The first direction is rough and must not reject good
cameras."""
MEAN_WEIGHT = 0.01
"""Weight of the mean of the cameras' up vectors relative to one camera: (3 / 30)^2, from typical degrees of roll and of error
of that mean."""
LEVEL_SINE, LEVEL_CAMERAS = 0.5, 0.6
"""Maximum sine of the roll of a level camera, and share of the cameras that must be level for right axes to be used."""


def upright(cameras: Sequence[Camera]) -> np.ndarray:
    """Return the unit up direction [3], perpendicular to the cameras' right axes as far as these determine it.

    A level camera's right axis is horizontal for any tilt. The mean of the up vectors leans instead, since cameras that look
    down lean forward together. The result u minimizes sum w (right u)^2 + MEAN_WEIGHT |u - mean|^2. The mean thus decides for a
    single camera, for parallel cameras and for cameras rolled at random. The weight w is small for rolled cameras.
    """
    rights = np.stack([camera.viewmat[0, :3] for camera in cameras])
    ups = -np.stack([camera.viewmat[1, :3] for camera in cameras])
    up = mean = _unit(ups.mean(0))
    for scale in ROLL_SCALES:
        weights = 1 / (1 + (rights @ up / scale) ** 2) ** 2
        spread = (rights * weights[:, None]).T @ rights
        up = _unit(np.linalg.solve(spread + MEAN_WEIGHT * np.eye(3), weights @ ups))
    return up if np.mean(np.abs(rights @ up) < LEVEL_SINE) >= LEVEL_CAMERAS else mean


def _unit(vector: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vector)
    return vector / length if length > 1e-6 else np.array([0.0, 0.0, 1.0])
