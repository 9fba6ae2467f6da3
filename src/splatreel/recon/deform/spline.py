"""Cubic B-splines over the frames of a group: what both deformation models start from when tracks are known."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import torch
from torch import Tensor

SMOOTHING = 0.05
"""Weight of a spline's second differences against the paths it follows."""

FRAMES_PER_KNOT = 2.0
"""Even spacing of the knots."""

SHARP, RINGING, TURN = 3.0, 0.3, 0.003
"""A part turns too sharply for the even spline where it leaves it SHARP times as far as in the median frame, RINGING times as far as
in the worst, as a spline that misses a turn swings around the path before and after, and TURN, in typical viewing distances: about a
pixel."""
PART = 0.01
"""Share of the points that a part needs for it: the tracks of a few jump."""


class Spline:
    """Control values decide four at a time: those of knot i to i + 3 between breaks[i] and breaks[i + 1].

    breaks: frames where its pieces meet; knots: control values it has. bends: frames with a knot each, and at their neighbors:
    what bounces off something turns within one.
    """

    def __init__(self, frames: int, bends: Iterable[int] = (), frames_per_knot: float = FRAMES_PER_KNOT) -> None:
        self.frames = frames
        self.last = max(frames - 1, 1)
        self.breaks = _breaks(self.last, bends, frames_per_knot)
        self.knots = len(self.breaks) + 2
        first, final = self.breaks[1] - self.breaks[0], self.breaks[-1] - self.breaks[-2]
        before, after = first * np.arange(-3, 0), self.last + final * np.arange(1, 4)
        self._extended = np.concatenate([before, self.breaks, after])
        self._whole: dict[float, tuple[int, np.ndarray]] = {frame: self._decide(frame) for frame in range(frames)}

    @classmethod
    def along(cls, paths: Tensor, parts: Tensor | None = None) -> Spline:
        """The spline with knots to follow paths [T, N, D], one value a frame, in typical viewing distances.

        Knots are closer where a part turns sharply. parts: [N], to which one each point belongs; the mean of all hides what one does.
        """
        even = cls(len(paths))
        if paths.shape[1] == 0:
            return even
        missed = even.values(even.fit(paths)) - paths
        parts = torch.zeros(paths.shape[1], device=paths.device) if parts is None else parts
        bends: set[int] = set()
        for part in parts.unique():
            rows = parts == part
            if rows.sum() >= PART * len(parts):
                bends |= _bends(missed[:, rows].median(1).values.norm(dim=1).cpu().numpy())
        return cls(len(paths), bends)

    def at(self, frame: float) -> tuple[int, np.ndarray]:
        """First of the four knots that decide a frame (a real number from 0), and their weights [4] float32."""
        return self._whole.get(frame) or self._decide(frame)  # an iteration asks for three, and finding one takes 30 us

    def _decide(self, frame: float) -> tuple[int, np.ndarray]:
        knot = int(np.clip(np.searchsorted(self.breaks, frame, side="right") - 1, 0, len(self.breaks) - 2))
        return knot, _basis(frame, self._extended[knot + 1 : knot + 7])

    def values(self, controls: Tensor) -> Tensor:
        """[T, N, D] the spline at every frame, for control values [knots, N, D]."""
        rows = torch.from_numpy(self._rows()).to(controls)
        return (rows @ controls.flatten(1)).view(-1, *controls.shape[1:])

    def fit(self, paths: Tensor) -> Tensor:
        """Control values [knots, N, D] of the smoothest spline close to paths [T, N, D], one value a frame."""
        rows = self._rows()
        bend = np.diff(np.eye(self.knots, dtype=np.float32), 2, axis=0)
        system = rows.T @ rows + SMOOTHING * bend.T @ bend + 1e-4 * np.eye(self.knots, dtype=np.float32)
        solve = torch.from_numpy(np.linalg.solve(system, rows.T).astype(np.float32)).to(paths.device)
        return (solve @ paths.flatten(1)).view(self.knots, *paths.shape[1:])

    def _rows(self) -> np.ndarray:
        """[T, knots] float32 weights of the control values at every frame."""
        rows = np.zeros((self.frames, self.knots), np.float32)
        for frame in range(self.frames):
            knot, weights = self.at(frame)
            rows[frame, knot : knot + 4] = weights
        return rows


def _bends(errors: np.ndarray) -> set[int]:
    """Frames in which a spline misses a turn, by how far it leaves a path in each."""
    peaks = (errors >= np.append(errors[1:], 0)) & (errors >= np.append(0, errors[:-1]))
    sharp = peaks & (errors > max(SHARP * np.median(errors), RINGING * errors.max(), TURN))
    return {int(frame) for frame in np.nonzero(sharp)[0] if 0 < frame < len(errors) - 1}


def _breaks(last: int, bends: Iterable[int], frames_per_knot: float) -> np.ndarray:
    even = np.linspace(0, last, max(1, round(last / frames_per_knot)) + 1)
    close = np.array([f for bend in bends for f in (bend - 1, bend, bend + 1) if 0 < f < last], np.float64)
    close = np.unique(close)
    apart = [f for f in close if np.abs(even - f).min() > 0.3]
    return np.sort(np.concatenate([even, apart]))


def _basis(x: float, knots: np.ndarray) -> np.ndarray:
    """Weights [4] float32 at x of the cubic B-splines over six knots, x between the middle two (Cox-de Boor)."""
    weights = np.zeros(4)
    weights[0] = 1
    for degree in range(1, 4):
        carried = 0.0
        for r in range(degree):
            right, left = knots[3 + r], knots[3 + r - degree]
            part = weights[r] / (right - left)
            weights[r] = carried + (right - x) * part
            carried = (x - left) * part
        weights[degree] = carried
    return weights.astype(np.float32)
