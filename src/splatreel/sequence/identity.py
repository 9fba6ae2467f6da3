"""Recognition of the same points in consecutive frames, which files do not record."""

from __future__ import annotations

import numpy as np

from splatreel.scene.gaussians import Gaussians

ALIKE = 0.25
"""Points in the same rows are the same if they differ by less than this share of the difference between random rows."""


class Identities:
    """Numbers of the points of a sequence. A point keeps its number as long as it is recognized."""

    def __init__(self) -> None:
        self.count = 0
        self._before: tuple[Gaussians, np.ndarray] | None = None

    def of(self, points: Gaussians) -> np.ndarray:
        """Return the numbers [N] int64 of the next frame's points. New points get numbers from `count` on.

        Most programs keep points in the same rows. If rows do not match, only points that have not moved are
        recognized.
        """
        numbers = np.full(len(points), -1)
        if self._before is not None:
            before, known = self._before
            if same_rows(before, points):
                numbers = known.copy()
            else:
                rows, place = unmoved(before, points)
                numbers[rows] = known[place]
        new = numbers < 0
        numbers[new] = np.arange(self.count, self.count + new.sum())
        self.count += int(new.sum())
        self._before = points, numbers
        return numbers


def same_rows(before: Gaussians, now: Gaussians) -> bool:
    """Return whether two frames hold the same points in the same order.

    Colors and scales decide, because they differ between points and change little over time.
    """
    if len(before) != len(now) or before.sh.shape != now.sh.shape or not len(now):
        return False
    a, b = _appearance(before), _appearance(now)
    shuffled = np.random.default_rng(0).permutation(len(now))
    return bool(np.abs(a - b).mean() <= ALIKE * np.abs(a - b[shuffled]).mean())


def _appearance(points: Gaussians) -> np.ndarray:
    """Return c_base and the logarithms of the scales, [N, 6]."""
    return np.concatenate([points.sh[:, 0], log_scales(points)], 1)


def log_scales(points: Gaussians) -> np.ndarray:
    """Return the logarithms of the scales, [N, 3], finite for a scale of 0."""
    return np.log(np.maximum(points.scales, 1e-12))


def unmoved(before: Gaussians, now: Gaussians) -> tuple[np.ndarray, np.ndarray]:
    """Return rows of `now` and rows of `before` with bitwise equal, unique centers."""
    rows_before, rows_now = _rows_with_unique_center(before), _rows_with_unique_center(now)
    keys = _centers(before)[rows_before], _centers(now)[rows_now]
    _, in_before, in_now = np.intersect1d(*keys, assume_unique=True, return_indices=True)
    return rows_now[in_now], rows_before[in_before]


def _rows_with_unique_center(points: Gaussians) -> np.ndarray:
    """Return the rows of points whose center no other point has."""
    _, first, counts = np.unique(_centers(points), return_index=True, return_counts=True)
    return first[counts == 1]


def _centers(points: Gaussians) -> np.ndarray:
    """Return the centers as [N] records of three numbers."""
    return np.ascontiguousarray(points.means).view([("x", "f4"), ("y", "f4"), ("z", "f4")]).ravel()
