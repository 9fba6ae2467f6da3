"""Points that rest while their light changes. They belong to a group like dynamic points, but only their colors change."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splatreel.scene.gaussians import C0, Gaussians


@dataclass(frozen=True)
class RelitPoints:
    """Resting points and the change of their light.

    Attributes:
        points: M points at the keyframe.
        light: [T, M] logarithm of each point's brightness at every frame, relative to the keyframe.
    """

    points: Gaussians
    light: np.ndarray

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.points)

    @property
    def shades(self) -> np.ndarray:
        """Change of c_base at every frame, [T, M, 3] float32."""
        return self._shade(self.light)

    @property
    def tracks(self) -> np.ndarray:
        """Positions at every frame, [T, M, 3] float32."""
        return np.repeat(self.points.means[None], len(self.light), 0)

    def at(self, frame: int) -> Gaussians:
        """Return the points with the colors they have at a frame."""
        return self.points.shaded(np.pad(self._shade(self.light[frame]), ((0, 0), (0, 1))))

    def _shade(self, light: np.ndarray) -> np.ndarray:
        """Return the change of c_base, [..., M, 3] float32, for a change of light [..., M]."""
        color = np.maximum(0.5 + C0 * self.points.sh[:, 0], 0)
        return (np.expm1(light)[..., None] * (color / C0)).astype(np.float32)
