"""How points were going when one group handed them to the next."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from splatreel.scene.group import Group

SAME_POINT_DISTANCE = 0.01
"""Of the viewing distance: how far the refinement of a keyframe takes a point, some pixels."""


@dataclass(frozen=True)
class VelocityPrior:
    """places: [N, 3] of points at a keyframe; motions: [N, 3] how they came there, world units a frame."""

    places: np.ndarray
    motions: np.ndarray

    @classmethod
    def of(cls, group: Group, frame: int) -> VelocityPrior:
        """Of a group's points at a frame, since the frame before."""
        here = group.at(frame).means
        return cls(here, here - group.at(frame - 1).means)

    def at(self, places: np.ndarray, unit: float) -> np.ndarray:
        """[M, 3] float32 for points at places [M, 3], which come from these: as the nearest one; none where that is far.

        unit: viewing distance, world units.
        """
        motions = np.zeros((len(places), 3), np.float32)
        if len(self.places) and len(places):
            distances, nearest = (np.asarray(column) for column in KDTree(self.places).query(places))
            near = distances < SAME_POINT_DISTANCE * unit
            motions[near] = self.motions[nearest[near]]
        return motions
