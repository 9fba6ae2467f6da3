"""Limits of viewpoints: how far a viewer may move from the training cameras."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse.csgraph import minimum_spanning_tree

from splatreel.codec.presentation import Limits
from splatreel.method.init.layout import Layout
from splatreel.scene.camera import Camera

MOST_CAMERAS = 0.9
"""Share of the cameras that must look at the focus, and quantile of the steps between neighboring cameras that decides the
angle."""
MIN_LOOKING_COSINE = 0.7
"""Minimum cosine of the angle between a camera's axis and the focus, for a camera that looks at it."""
STEP_SHARE, MARGIN_DEGREES, LEAST_DEGREES, MOST_DEGREES = 0.75, 5.0, 10.0, 45.0
"""The angle is `STEP_SHARE` of a step from camera to camera (half a step is the middle between two) plus `MARGIN_DEGREES`,
clamped to `LEAST_DEGREES`..`MOST_DEGREES`."""
NEAREST, FARTHEST = 0.25, 1.25
"""Limits of the distance, as shares of the smallest and the largest distance of a camera from the focus."""
FLOOR_PERCENTILE = 2.0
"""Percentage of the points around the focus that may lie below the floor: noise and reflections."""
MIN_FLOOR_POINTS = 100
"""Minimum number of points that determine a floor."""


def limits(cameras: Sequence[Camera], points: np.ndarray, layout: Layout, most: float | None = None) -> Limits | None:
    """Return the limits of viewpoints for cameras around a subject; None for cameras that do not look at a common focus.

    Views between neighboring cameras hold, and about as far beyond the outer ones. The angle follows from the steps of the
    shortest path through all cameras. The floor lies below nearly all points around the focus and below every camera.

    Args:
        cameras: Training cameras.
        points: [P, 3] initial points.
        layout: Measures of the scene, with the focus.
        most: Maximum angle, degrees, if a trial showed that views do not hold (`method/prediction/trial.py`); None means no maximum.
    """
    focus, up = np.array(layout.clearance.focus), np.array(layout.up)
    centers = np.stack([camera.center for camera in cameras]).astype(np.float64)
    away = centers - focus
    distances = np.linalg.norm(away, axis=1)
    if distances.min() < 1e-6:
        return None
    directions = away / distances[:, None]
    ahead = np.stack([camera.viewmat[2, :3] for camera in cameras])
    if np.mean((ahead * -directions).sum(1) > MIN_LOOKING_COSINE) < MOST_CAMERAS:
        return None
    angle = _angle(directions)
    return Limits(
        focus=layout.clearance.focus,
        angle=angle if most is None else min(angle, most),
        distance=(round(NEAREST * float(distances.min()), 6), round(FARTHEST * float(distances.max()), 6)),
        floor=_floor(points, centers @ up, focus, up, 2 * distances.max()),
    )


def _angle(directions: np.ndarray) -> float:
    """Return the angle, degrees, for unit directions [C, 3] from the focus to the cameras."""
    between = np.degrees(np.arccos(np.clip(directions @ directions.T, -1, 1)))
    steps = minimum_spanning_tree(between).data
    step = float(np.quantile(steps, MOST_CAMERAS, method="lower")) if len(steps) else 0.0
    return round(min(max(STEP_SHARE * step + MARGIN_DEGREES, LEAST_DEGREES), MOST_DEGREES), 2)


def _floor(points: np.ndarray, cameras: np.ndarray, focus: np.ndarray, up: np.ndarray, radius: float) -> float | None:
    """Return the height of the floor along `up`; None for too few points.

    Args:
        points: [P, 3] initial points.
        cameras: [C] heights of the cameras.
        focus: [3] center of the subject.
        up: [3] up direction.
        radius: Radius of the subject around the focus, world units.
    """
    around = points[np.linalg.norm(points - focus, axis=1) < radius]
    if len(around) < MIN_FLOOR_POINTS:
        return None
    return round(min(float(np.percentile(around @ up, FLOOR_PERCENTILE)), float(cameras.min())), 6)
