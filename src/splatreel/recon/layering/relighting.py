"""Points that rest while their light changes: they belong to a group as what moves does, and only their colors change."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splatreel.scene.gaussians import C0, Gaussians


@dataclass(frozen=True)
class RelitPoints:
    """points: M of them, as at the keyframe. light: [T, M] logarithm of their brightness against that, at every frame of the group."""

    points: Gaussians
    light: np.ndarray

    def __len__(self) -> int:
        return len(self.points)

    @property
    def shades(self) -> np.ndarray:
        """[T, M, 3] float32, what their c_base gains at every frame."""
        return self._shade(self.light)

    @property
    def tracks(self) -> np.ndarray:
        """[T, M, 3] float32, where they are at every frame."""
        return np.repeat(self.points.means[None], len(self.light), 0)

    def at(self, frame: int) -> Gaussians:
        """The points in the light of a frame."""
        return self.points.shaded(np.pad(self._shade(self.light[frame]), ((0, 0), (0, 1))))

    def _shade(self, light: np.ndarray) -> np.ndarray:
        """[..., M, 3] float32, what c_base gains in a light [..., M]."""
        color = np.maximum(0.5 + C0 * self.points.sh[:, 0], 0)
        return (np.expm1(light)[..., None] * (color / C0)).astype(np.float32)
