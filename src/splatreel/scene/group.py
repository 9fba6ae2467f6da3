"""A group of Gaussians (GOG, paper section 4): what a reel stores for one group of frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splatreel.errors import GaussiansError
from splatreel.scene.gaussians import Gaussians


@dataclass(frozen=True)
class Group:
    """Dynamic points with their offsets over a group's frames, and which static points are alive in it.

    dynamic: the canonical points P^d, at the keyframe or wherever training left them.
    dx: [T, N, 3] float32 position offsets, world units. dq: [T, N, 4] float32 rotation offsets, wxyz, about unit.
    T counts the group's own frames plus the overlap with the next group.
    alive: [S] bool over all static points of the layers that live at this group (born by then, not retired), in reel order.
    shade: [T, N, 4] float32, what c_base and the opacity gain on their canonical values; None where they stay. Beyond the paper:
    light and shadow pass over things, flames flicker, things come and go.
    light: [T, 3] float32, factors by which everything is brighter in red, green and blue; None where it is not. Beyond the paper.
    """

    index: int
    first_frame: int
    dynamic: Gaussians
    dx: np.ndarray
    dq: np.ndarray
    alive: np.ndarray
    shade: np.ndarray | None = None
    light: np.ndarray | None = None

    def __post_init__(self) -> None:
        frames, n = self.dx.shape[0], len(self.dynamic)
        if self.dx.shape != (frames, n, 3) or self.dq.shape != (frames, n, 4):
            raise GaussiansError(
                f"Group {self.index}: dx {self.dx.shape} and dq {self.dq.shape} do not fit {n} dynamic points."
            )
        if self.shade is not None and self.shade.shape != (frames, n, 4):
            raise GaussiansError(f"Group {self.index}: shade {self.shade.shape} does not fit {n} dynamic points.")
        if self.light is not None and self.light.shape != (frames, 3):
            raise GaussiansError(f"Group {self.index}: light {self.light.shape} does not fit {frames} frames.")
        if frames < 1:
            raise GaussiansError(f"Group {self.index}: holds no frame.")

    @property
    def frames(self) -> int:
        return self.dx.shape[0]

    def at(self, frame: float) -> Gaussians:
        """The dynamic points at a frame counted from first_frame; between frames dx and shade are linear, dq normalized linear.

        Times outside the group are clamped to its first and last frame. Without its light, which is that of the static points, too.
        """
        low, high, u = self._between(frame)
        dx = (1 - u) * self.dx[low] + u * self.dx[high]
        a, b = self.dq[low], self.dq[high]
        near = np.where((a * b).sum(-1, keepdims=True) < 0, -b, b)  # the shorter way round
        moved = self.dynamic.moved(dx, (1 - u) * a + u * near)
        return moved if self.shade is None else moved.shaded((1 - u) * self.shade[low] + u * self.shade[high])

    def light_at(self, frame: float) -> np.ndarray | None:
        """[3], linear between frames, clamped as in `at`; None where the light stays."""
        if self.light is None:
            return None
        low, high, u = self._between(frame)
        return (1 - u) * self.light[low] + u * self.light[high]

    def _between(self, frame: float) -> tuple[int, int, np.float32]:
        """The frames around a time, and how far it is from the first to the second."""
        frame = float(np.clip(frame, 0, self.frames - 1))
        low = min(int(frame), max(self.frames - 2, 0))
        return low, min(low + 1, self.frames - 1), np.float32(frame - low)
