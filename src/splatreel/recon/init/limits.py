"""How far from the cameras views hold: what a player holds people to, softly."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse.csgraph import minimum_spanning_tree

from splatreel.codec.presentation import Limits
from splatreel.recon.init.layout import Layout
from splatreel.scene.camera import Camera

MOST_CAMERAS = 0.9
"""The share of the cameras that must look at the focus, and of the steps between neighbors that views must hold all along."""
LOOKING = 0.7
"""The cosine of the angle at which the focus lies for a camera that looks at it, at least."""
STEP_SHARE, MARGIN_DEGREES, LEAST_DEGREES, MOST_DEGREES = 0.75, 5.0, 10.0, 45.0
"""The angle: this much of a step from camera to camera (half a step is the middle between two), and degrees more."""
NEAREST, FARTHEST = 0.25, 1.25
"""Of the least and the largest distance of a camera from the focus."""
LOWEST = 2.0
"""Percent of the points around the focus that may lie below the floor: noise, and what a mirror shows."""
FEWEST_FLOOR_POINTS = 100
"""Points that tell of no floor."""


def limits(cameras: Sequence[Camera], points: np.ndarray, layout: Layout, most: float | None = None) -> Limits | None:
    """Of a rig around something, which the focus of `layout` is the middle of; None for cameras that look away from it.

    Between neighboring cameras views hold, and about as far beyond the outer ones: the angle is that which takes nine of ten steps
    of the shortest way through all cameras. points: [P, 3], initial points; the floor is below nearly all of them that are around
    the focus, and below every camera. most: degrees that the angle is at most, where a trial has shown that views do not hold
    (`recon/coverage/trial.py`).
    """
    focus, up = np.array(layout.clearance.focus), np.array(layout.up)
    centers = np.stack([camera.center for camera in cameras]).astype(np.float64)
    away = centers - focus
    distances = np.linalg.norm(away, axis=1)
    if distances.min() < 1e-6:
        return None
    directions = away / distances[:, None]
    ahead = np.stack([camera.viewmat[2, :3] for camera in cameras])
    if np.mean((ahead * -directions).sum(1) > LOOKING) < MOST_CAMERAS:
        return None
    angle = _angle(directions)
    return Limits(
        focus=layout.clearance.focus,
        angle=angle if most is None else min(angle, most),
        distance=(round(NEAREST * float(distances.min()), 6), round(FARTHEST * float(distances.max()), 6)),
        floor=_floor(points, centers @ up, focus, up, 2 * distances.max()),
    )


def _angle(directions: np.ndarray) -> float:
    """Degrees. directions: [C, 3], unit, of the cameras from the focus; two at one place are one."""
    between = np.degrees(np.arccos(np.clip(directions @ directions.T, -1, 1)))
    steps = minimum_spanning_tree(between).data
    step = float(np.quantile(steps, MOST_CAMERAS, method="lower")) if len(steps) else 0.0
    return round(min(max(STEP_SHARE * step + MARGIN_DEGREES, LEAST_DEGREES), MOST_DEGREES), 2)


def _floor(points: np.ndarray, cameras: np.ndarray, focus: np.ndarray, up: np.ndarray, radius: float) -> float | None:
    """A height along `up`; None where points do not tell. cameras: [C], their heights. radius: of what is around the focus."""
    around = points[np.linalg.norm(points - focus, axis=1) < radius]
    if len(around) < FEWEST_FLOOR_POINTS:
        return None
    return round(min(float(np.percentile(around @ up, LOWEST)), float(cameras.min())), 6)
