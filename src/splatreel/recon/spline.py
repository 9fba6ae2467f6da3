"""Uniform cubic B-splines over the frames of a group: what both deformation models start from when tracks are known."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

SMOOTHING = 0.05
"""Weight of a spline's second differences against the tracks it follows."""

FRAMES_PER_KNOT = 2.0
"""What bounces turns within two frames; knots farther apart cut the corner."""


class Spline:
    """Where the knots of `frames` frames lie. intervals: pieces of the spline; knots: control values it has, intervals + 3."""

    def __init__(self, frames: int) -> None:
        self.last = max(frames - 1, 1)
        self.intervals = max(1, round(self.last / FRAMES_PER_KNOT))
        self.knots = self.intervals + 3

    def at(self, frame: float) -> tuple[int, np.ndarray]:
        """First of the four knots that decide a frame (a real number from 0), and their weights [4] float32."""
        return basis(frame / self.last * self.intervals, self.intervals)

    def fit(self, values: Tensor) -> Tensor:
        """Control values [knots, N, D] of the smoothest spline close to values [T, N, D], one a frame."""
        frames = len(values)
        rows = np.zeros((frames, self.knots), np.float32)
        for frame in range(frames):
            knot, weights = self.at(frame)
            rows[frame, knot : knot + 4] = weights
        bend = np.diff(np.eye(self.knots, dtype=np.float32), 2, axis=0)
        system = rows.T @ rows + SMOOTHING * bend.T @ bend + 1e-4 * np.eye(self.knots, dtype=np.float32)
        solve = torch.from_numpy(np.linalg.solve(system, rows.T).astype(np.float32)).to(values.device)
        return (solve @ values.reshape(frames, -1)).view(self.knots, *values.shape[1:])


def basis(u: float, intervals: int) -> tuple[int, np.ndarray]:
    """First knot and the four weights [4] float32 of the uniform cubic B-spline at u in 0..intervals."""
    knot = min(max(int(u), 0), intervals - 1)
    f = u - knot
    weights = [(1 - f) ** 3, 3 * f**3 - 6 * f**2 + 4, -3 * f**3 + 3 * f**2 + 3 * f + 1, f**3]
    return knot, np.array(weights, np.float32) / np.float32(6)
