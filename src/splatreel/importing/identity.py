"""Recognition of the same points in consecutive frames, which files do not record."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from splatreel.scene.gaussians import Gaussians

ALIKE = 0.25
"""Points in the same rows are the same if they differ by less than this share of the difference between random rows."""
PLACE, COLOR, SIZE = 3.0, 0.3, 0.3
"""Differences that make points unlike: distance as a share of the typical scale, c_base, and logarithms of scales."""


class Identities:
    """Numbers of the points of a sequence. A point keeps its number as long as it is recognized."""

    def __init__(self) -> None:
        self.count = 0
        self._before: tuple[Gaussians, np.ndarray, np.ndarray] | None = None

    def of(self, points: Gaussians) -> np.ndarray:
        """Return the numbers [N] int64 of the next frame's points. New points get numbers from `count` on.

        Most programs keep points in the same rows. If rows do not match, points are recognized by place, shape and
        color.
        """
        numbers, motion = np.full(len(points), -1), np.zeros((len(points), 3))
        if self._before is not None:
            before, known, moved = self._before
            rows = place = np.arange(len(points))
            if not same_rows(before, points):
                rows, place = matching_rows(before, points, moved)
            numbers[rows] = known[place]
            motion[rows] = points.means[rows] - before.means[place]
        new = numbers < 0
        numbers[new] = np.arange(self.count, self.count + new.sum())
        self.count += int(new.sum())
        self._before = points, numbers, motion
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


def matching_rows(before: Gaussians, now: Gaussians, motion: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return rows of `now` and rows of `before` that hold the same points.

    Points with equal positions are the same, then points of exactly equal scales and colors, then points that are
    each other's nearest by place, color and scales together.

    Args:
        before: Points of the frame before, [N].
        now: Points of the frame.
        motion: Motion of the points from the frame before `before`, [N, 3], which is expected to go on.
    """
    left, there = np.arange(len(now)), np.arange(len(before))
    found: list[tuple[np.ndarray, np.ndarray]] = []
    for pair in (_equal_places, _equal_looks, _nearest):
        mine, theirs = pair(before[there], now[left], motion[there])
        found.append((left[mine], there[theirs]))
        left, there = np.delete(left, mine), np.delete(there, theirs)
    rows, places = (np.concatenate(part) for part in zip(*found, strict=True))
    return rows, places


def _equal_places(before: Gaussians, now: Gaussians, motion: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return _equal(before.means, now.means)


def _equal_looks(before: Gaussians, now: Gaussians, motion: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if before.sh.shape[1:] != now.sh.shape[1:]:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    return _equal(*(np.concatenate([points.scales, points.sh[:, 0]], 1) for points in (before, now)))


def _equal(before: np.ndarray, now: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return rows of `now` [N, K] and of `before` [M, K] that are bitwise equal and unique."""
    keys, rows = [], []
    for values in (before, now):
        records = np.ascontiguousarray(values).view([(f"f{i}", "f4") for i in range(values.shape[1])]).ravel()
        key, first, counts = np.unique(records, return_index=True, return_counts=True)
        keys.append(key[counts == 1])
        rows.append(first[counts == 1])
    _, mine, theirs = np.intersect1d(keys[1], keys[0], assume_unique=True, return_indices=True)
    return rows[1][mine], rows[0][theirs]


def _nearest(before: Gaussians, now: Gaussians, motion: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Match points that are each other's nearest by place, color and scales."""
    if not len(before) or not len(now):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    size = PLACE * float(np.exp(np.median(log_scales(before))))
    then, here = (
        np.concatenate([means / size, points.sh[:, 0] / COLOR, np.sort(log_scales(points), 1) / SIZE], 1)
        for means, points in ((before.means + motion, before), (now.means, now))
    )
    nearest, back = (
        np.asarray(KDTree(tree).query(asked, distance_upper_bound=1.0)[1])
        for tree, asked in ((then, here), (here, then))
    )
    mine = np.flatnonzero(nearest < len(then))
    mine = mine[back[nearest[mine]] == mine]
    return mine, nearest[mine]
