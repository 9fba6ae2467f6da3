"""Points far beyond all others. They get layers of their own, because positions of a layer share one quantization step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splatreel.codec.predictive.points import MAX_BITS
from splatreel.codec.predictive.precision import STEPS, coarsest_class
from splatreel.config import EncodeConfig
from splatreel.importing.viewpoints import visible_positions
from splatreel.scene.gaussians import Gaussians

SHELL = 16.0
"""Ratio of the distances of the farthest and the nearest point of a layer of far points."""
STEADY = 1e-3
"""A far point is static if it moves by less than this share of its distance."""
STEADY_COLOR = 0.02
"""Maximum change of color and opacity of a static far point."""


@dataclass(frozen=True)
class Reach:
    """Region whose points can share a layer without a coarser quantization step.

    Attributes:
        middle: Middle of the region, [3] float64.
        radius: Half of its width, world units.
    """

    middle: np.ndarray
    radius: float

    @staticmethod
    def of(points: Gaussians, config: EncodeConfig) -> Reach:
        """Return the region around the median of points."""
        size = float(np.exp(np.median(np.log(np.maximum(points.scales, 1e-30)))))
        step = STEPS.position * config.coarseness * size * 2 ** coarsest_class(config.coarseness)
        return Reach(np.median(visible_positions(points), axis=0), step * ((1 << MAX_BITS) - 1) / 2)

    def shells(self, points: Gaussians) -> np.ndarray:
        """Return the layer of each point, [N] int: 0 within the region, then higher by distance."""
        distance = self._distance(points)
        return np.ceil(np.log(np.maximum(distance / self.radius, 1)) / np.log(SHELL)).astype(np.int64)

    def steady(self, reference: Gaussians, points: Gaussians) -> np.ndarray:
        """Return which points are far and look the same, [N] bool."""
        moved = np.linalg.norm(points.means - reference.means, axis=1)
        color = np.abs(points.sh[:, 0] - reference.sh[:, 0]).max(1, initial=0.0)
        alike = np.maximum(color, np.abs(points.opacities - reference.opacities)) <= STEADY_COLOR
        distance = self._distance(reference)
        return (distance > self.radius) & (moved <= STEADY * distance) & alike

    def _distance(self, points: Gaussians) -> np.ndarray:
        return np.abs(points.means - self.middle).max(1, initial=0.0)
