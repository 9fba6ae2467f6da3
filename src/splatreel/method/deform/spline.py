"""Cubic B-splines over the frames of a group. Both deformation models start from them if tracks are known."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

SMOOTHING = 0.05
"""Weight of a spline's second differences relative to the paths it is fitted to."""

FRAMES_PER_KNOT = 2.0
"""Even spacing of the knots."""

SHARP, RINGING, TURN = 3.0, 0.3, 0.003
"""A part turns too sharply for the even spline where its error is a peak above three limits: `SHARP` times the median error,
`RINGING` times the maximum error, since a spline that misses a turn oscillates around the path, and `TURN` viewing
distances, about a pixel."""
PART = 0.01
"""Minimum share of the points for a part to count. Tracks of a few points jump."""


class Spline:
    """Cubic B-spline. Between breaks[i] and breaks[i + 1] the control values i to i + 3 determine it.

    Attributes:
        breaks: Frames at which its pieces meet.
        knots: Number of control values.
    """

    def __init__(self, frames: int, bends: Iterable[int] = (), frames_per_knot: float = FRAMES_PER_KNOT) -> None:
        """Place the knots.

        Frames with sharp turns (`bends`) and their neighbors get one each, since a bounce happens within one frame.
        """
        self.frames = frames
        self.last = max(frames - 1, 1)
        self.breaks = _breaks(self.last, bends, frames_per_knot)
        self.knots = len(self.breaks) + 2
        first, final = self.breaks[1] - self.breaks[0], self.breaks[-1] - self.breaks[-2]
        before, after = first * np.arange(-3, 0), self.last + final * np.arange(1, 4)
        self._extended = np.concatenate([before, self.breaks, after])
        self._whole: dict[float, tuple[int, np.ndarray]] = {frame: self._decide(frame) for frame in range(frames)}

    @classmethod
    def along(cls, paths: np.ndarray, parts: np.ndarray | None = None) -> Spline:
        """Return the spline with knots to follow paths, more densely where a part turns sharply.

        `paths` [T, N, D] are in typical viewing distances. `parts` [N] divides the points: the mean of all would hide
        the turn of one part.
        """
        even = cls(len(paths))
        if paths.shape[1] == 0:
            return even
        missed = even.values(even.fit(paths)) - paths
        parts = np.zeros(paths.shape[1]) if parts is None else parts
        bends: set[int] = set()
        for part in np.unique(parts):
            rows = parts == part
            if rows.sum() >= PART * len(parts):
                bends |= _bends(np.linalg.norm(np.quantile(missed[:, rows], 0.5, axis=1, method="lower"), axis=1))
        return cls(len(paths), bends)

    def at(self, frame: float) -> tuple[int, np.ndarray]:
        """Return the first of the four knots that determine a frame (a real number from 0), and their weights [4] float32."""
        return self._whole.get(frame) or self._decide(frame)  # three calls per iteration, 30 us each if not stored

    def _decide(self, frame: float) -> tuple[int, np.ndarray]:
        knot = int(np.clip(np.searchsorted(self.breaks, frame, side="right") - 1, 0, len(self.breaks) - 2))
        return knot, _basis(frame, self._extended[knot + 1 : knot + 7])

    def values(self, controls: np.ndarray) -> np.ndarray:
        """Return the spline at every frame, [T, N, D], for control values [knots, N, D]."""
        return (self._rows() @ controls.reshape(self.knots, -1)).reshape(self.frames, *controls.shape[1:])

    def fit(self, paths: np.ndarray) -> np.ndarray:
        """Return the control values [knots, N, D] of the smoothest spline close to paths [T, N, D], one value per frame."""
        rows = self._rows()
        bend = np.diff(np.eye(self.knots, dtype=np.float32), 2, axis=0)
        system = rows.T @ rows + SMOOTHING * bend.T @ bend + 1e-4 * np.eye(self.knots, dtype=np.float32)
        solve = np.linalg.solve(system, rows.T).astype(np.float32)
        return (solve @ paths.reshape(len(paths), -1)).reshape(self.knots, *paths.shape[1:])

    def _rows(self) -> np.ndarray:
        """Return the weights [T, knots] float32 of the control values at every frame."""
        rows = np.zeros((self.frames, self.knots), np.float32)
        for frame in range(self.frames):
            knot, weights = self.at(frame)
            rows[frame, knot : knot + 4] = weights
        return rows


def _bends(errors: np.ndarray) -> set[int]:
    """Return the frames in which a spline misses a turn, from its errors [T]."""
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
    """Return the weights [4] float32 at x of the cubic B-splines over six knots, x between the middle two (Cox-de Boor)."""
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
