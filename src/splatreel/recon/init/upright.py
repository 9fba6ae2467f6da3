"""Which way is up, from how cameras stand: people hold them level, whether they look up or down."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from splatreel.scene.camera import Camera

SCALES = [math.sin(math.radians(angle)) for angle in (45, 30, 20, 12, 12, 12, 12)]
"""Roll at which a camera begins to count for little, step by step: the first direction is rough, and must not throw out good ones."""
TRUST = 0.01
"""How much the mean of the cameras' own up counts beside one camera: (3 / 30)^2, the degrees by which cameras roll and by which
that mean leans."""
LEVEL_SINE, LEVEL_CAMERAS = 0.5, 0.6
"""The sine of a level camera's roll at most, and the share of the cameras that must be level, or else none is taken to be."""


def upright(cameras: Sequence[Camera]) -> np.ndarray:
    """Unit up direction [3] of the world that cameras stand in: perpendicular to their right axes, as far as these decide it.

    The mean of their up vectors leans to where most of them look from, for cameras that look down lean forward together; a level
    camera's right axis is horizontal however it looks. u minimizes sum w (right u)^2 + TRUST |u - mean|^2, so that the mean decides
    where right axes do not: of one camera, of parallel ones, and of cameras rolled at random. w falls for a camera on its side.
    """
    rights = np.stack([camera.viewmat[0, :3] for camera in cameras])
    ups = -np.stack([camera.viewmat[1, :3] for camera in cameras])
    up = mean = _unit(ups.mean(0))
    for scale in SCALES:
        weights = 1 / (1 + (rights @ up / scale) ** 2) ** 2
        spread = (rights * weights[:, None]).T @ rights
        up = _unit(np.linalg.solve(spread + TRUST * np.eye(3), weights @ ups))
    return up if np.mean(np.abs(rights @ up) < LEVEL_SINE) >= LEVEL_CAMERAS else mean


def _unit(vector: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vector)
    return vector / length if length > 1e-6 else np.array([0.0, 0.0, 1.0])
