"""Height of the floor of a clip."""

from __future__ import annotations

import numpy as np

from splatreel.base.errors import UsageError
from splatreel.edit.clip import Clip, shown_points
from splatreel.scene import rotations
from splatreel.scene.volumes import CaptureVolume

FLAT = 0.8
"""Cosine between up and the thinnest axis above which a point is part of a horizontal surface."""
BINS = 200
"""Heights that are told apart, between the lowest and the highest horizontal surface."""
FEWEST = 20
"""Number of horizontal points below the cameras' focus that a floor has."""


def floor_height(clip: Clip) -> float:
    """Return the height along `up` of the largest horizontal surface below the focus, at the first frame.

    Points count by their area and opacity. At least two cameras have them in their images.

    Raises:
        UsageError: There is no horizontal surface.
    """
    header = clip.outline.header
    points, _, _ = shown_points(clip, 0, 0.0)
    cameras = header.cameras
    seen = CaptureVolume(cameras, header.near, 2 / max(len(cameras), 2)).contains(points.means)
    points = points[seen] if seen.any() else points
    thinnest = points.scales.argmin(1)
    normals = rotations.to_matrix(points.quats)[np.arange(len(points)), :, thinnest]
    heights = points.means @ header.up
    flat = (np.abs(normals @ header.up) > FLAT) & (heights < clip.outline.focus @ header.up)
    if flat.sum() < FEWEST:
        raise UsageError(
            f"floor: {clip.outline.name} shows no floor below the middle of the scene. Write move=X,Y,Z with the shift instead, or "
            "turn the scene upright first (rotate)."
        )
    areas = np.sort(points.scales[flat], axis=1)[:, 1:].prod(1) * points.opacities[flat]
    heights = heights[flat]
    low, high = np.quantile(heights, [0.001, 0.999])
    sums, edges = np.histogram(heights, BINS, (low, max(high, low + 1e-9)), weights=areas)
    smooth = np.convolve(sums, [0.5, 1, 0.5], "same")
    best = int(smooth.argmax())
    near = np.abs(heights - (edges[best] + edges[best + 1]) / 2) <= edges[1] - edges[0]
    return float(np.average(heights[near], weights=np.maximum(areas[near], 1e-30)))
