"""Which points of one frame are those of the frame before: files do not say it."""

from __future__ import annotations

import numpy as np

from splatreel.scene.gaussians import Gaussians

ALIKE = 0.25
"""Points in the same rows are the same ones if they differ by less than this share of what points in other rows do."""


class Identities:
    """Numbers the points of a film, frame after frame: a point keeps its number as long as it is recognized."""

    def __init__(self) -> None:
        self.count = 0
        self._before: tuple[Gaussians, np.ndarray] | None = None

    def of(self, points: Gaussians) -> np.ndarray:
        """[N] int64: the numbers of the next frame's points, those that are new from `count` on.

        Most programs write the same points in the same rows. Where rows do not fit, a point is recognized that has not moved at all.
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
    """Whether two frames hold the same points in the same order: by colors and sizes, which tell points apart and hardly change."""
    if len(before) != len(now) or before.sh.shape != now.sh.shape or not len(now):
        return False
    a, b = _look(before), _look(now)
    shuffled = np.random.default_rng(0).permutation(len(now))
    return bool(np.abs(a - b).mean() <= ALIKE * np.abs(a - b[shuffled]).mean())


def _look(points: Gaussians) -> np.ndarray:
    """[N, 6]: c_base, and the logarithms of the scales."""
    return np.concatenate([points.sh[:, 0], log_scales(points)], 1)


def log_scales(points: Gaussians) -> np.ndarray:
    """[N, 3], finite also where a scale is 0."""
    return np.log(np.maximum(points.scales, 1e-12))


def unmoved(before: Gaussians, now: Gaussians) -> tuple[np.ndarray, np.ndarray]:
    """Rows of `now` whose center is that of a row of `before`, to the bit, and these rows; where a center is there once only."""
    rows_before, rows_now = _once(before), _once(now)
    keys = _centers(before)[rows_before], _centers(now)[rows_now]
    _, in_before, in_now = np.intersect1d(*keys, assume_unique=True, return_indices=True)
    return rows_now[in_now], rows_before[in_before]


def _once(points: Gaussians) -> np.ndarray:
    """Rows of the points that have their center to themselves."""
    _, first, counts = np.unique(_centers(points), return_index=True, return_counts=True)
    return first[counts == 1]


def _centers(points: Gaussians) -> np.ndarray:
    """[N], each of three numbers."""
    return np.ascontiguousarray(points.means).view([("x", "f4"), ("y", "f4"), ("z", "f4")]).ravel()
