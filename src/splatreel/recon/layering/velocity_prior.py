"""Velocities of points at the boundary between two groups."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from splatreel.scene.group import Group

SAME_POINT_DISTANCE = 0.01
"""Maximum distance between matching points, as a share of the viewing distance. Keyframe training moves a point by a few
pixels."""


@dataclass(frozen=True)
class VelocityPrior:
    """Velocities that one group passes to the next.

    Attributes:
        places: [N, 3] positions at the next group's keyframe.
        motions: [N, 3] motion from the frame before, world units per frame.
    """

    places: np.ndarray
    motions: np.ndarray

    @classmethod
    def of(cls, group: Group, frame: int) -> VelocityPrior:
        """Compute the velocities of a group's dynamic points at a frame from the frame before."""
        here = group.at(frame).means
        return cls(here, here - group.at(frame - 1).means)

    def at(self, places: np.ndarray, unit: float) -> np.ndarray:
        """Return the velocity [M, 3] float32 of the nearest known point; zero if that point is too far away.

        Args:
            places: [M, 3] positions at the keyframe.
            unit: Viewing distance, world units.
        """
        motions = np.zeros((len(places), 3), np.float32)
        if len(self.places) and len(places):
            distances, nearest = (np.asarray(column) for column in KDTree(self.places).query(places))
            near = distances < SAME_POINT_DISTANCE * unit
            motions[near] = self.motions[nearest[near]]
        return motions
