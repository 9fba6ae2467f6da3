"""Conversion of segments to static layers and groups of a reel."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from splatreel.importing.far_points import Reach
from splatreel.importing.segments import Segments, is_unchanged
from splatreel.scene import rotations
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group

FEWEST = 100
"""Minimum number of points of a layer. Fewer points are not worth a file and are stored as dynamic."""
STILL = 1e-3
"""Smaller changes of color and opacity are dropped."""


class StaticLayers:
    """Static points of all layers of the reel so far, and their points in the sequence.

    Attributes:
        points: Points as read, [S], in reel order.
    """

    def __init__(self, sh_degree: int, reach: Reach) -> None:
        self.reach = reach
        self.points = Gaussians.empty(sh_degree)
        self._row_of = np.zeros(0, np.int64)

    def split(self, frames: Sequence[Gaussians], segments: Segments) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Split the segments of a stretch into static and dynamic ones.

        An unchanged point is static if it is static already, or if enough points become static together. A point far
        beyond the others is static if it hardly moves for its distance.

        Args:
            frames: Frames of the stretch.
            segments: Segments of the stretch.

        Returns:
            alive [S] bool: the static points that the stretch shows; the segments [B] that become static now; the
            dynamic segments [M].
        """
        unchanged = np.flatnonzero(segments.unchanged | self._steady(frames, segments))
        points = frames[0][segments.rows[0, unchanged]]
        row = self._rows(segments.numbers)[unchanged]
        known = row >= 0
        before = self.points[row[known]]
        known[known] = is_unchanged(before, points[known]) | self.reach.steady(before, points[known])
        alive = np.zeros(len(self.points), bool)
        alive[row[known]] = True
        born, far = unchanged[~known], self.reach.shells(points[~known]) > 0
        if (~far).sum() < FEWEST:
            born = born[far]
        static = np.concatenate([unchanged[known], born])
        return alive, born, np.setdiff1d(np.arange(len(segments.numbers)), static)

    def add(self, points: Gaussians, numbers: np.ndarray) -> None:
        """Add the points of a layer in the order of its file. A point that an earlier layer holds too is replaced."""
        self._rows(numbers)
        self._row_of[numbers] = np.arange(len(self.points), len(self.points) + len(points))
        self.points = Gaussians.concatenate([self.points, points])

    def _steady(self, frames: Sequence[Gaussians], segments: Segments) -> np.ndarray:
        """Return which segments are far points that are in all frames and look the same in all of them, [S] bool."""
        steady = np.asarray((segments.rows >= 0).all(0))
        steady[steady] = self.reach.shells(frames[0][segments.rows[0, steady]]) > 0
        if steady.any():
            first = frames[0][segments.rows[0, steady]]
            looks = [
                self.reach.steady(first, frame[rows[steady]]) for frame, rows in zip(frames, segments.rows, strict=True)
            ]
            steady[steady] = np.logical_and.reduce(looks)
        return steady

    def _rows(self, numbers: np.ndarray) -> np.ndarray:
        """Return the row in `points` of each numbered point, [N]; -1 for none."""
        missing = numbers.max(initial=-1) + 1 - len(self._row_of)
        if missing > 0:
            self._row_of = np.concatenate([self._row_of, np.full(missing, -1)])
        return self._row_of[numbers]


def group_of(index: int, first_frame: int, frames: Sequence[Gaussians], rows: np.ndarray, alive: np.ndarray) -> Group:
    """Return the group of dynamic points of a stretch.

    A point is stored with the values of its first frame. Before and after its frames it stays in place with opacity 0.

    Args:
        index: Number of the group.
        first_frame: First frame of the group.
        frames: Frames of the stretch, T.
        rows: Row of each point in each frame, [T, M]; -1 where the point is absent.
        alive: Alive flags of the static points.
    """
    there = rows >= 0
    if not rows.shape[1]:
        empty = np.zeros((len(frames), 0, 4), np.float32)
        return Group(index, first_frame, frames[0][:0], empty[..., :3], empty, alive)
    nearest = _nearest_presence(there)
    columns = np.arange(rows.shape[1])
    start = there.argmax(0)
    first = Gaussians.concatenate([frames[t][rows[t, start == t]] for t in range(len(frames))])
    place = np.empty(len(columns), np.int64)
    place[np.argsort(start, kind="stable")] = columns
    points = first[place]
    means, quats, looks = (np.empty((len(frames), len(columns), size), np.float32) for size in (3, 4, 4))
    for t, frame in enumerate(frames):
        some = there[t]
        seen = frame[rows[t, some]]
        means[t, some], quats[t, some] = seen.means, seen.quats
        looks[t, some] = np.concatenate([seen.sh[:, 0], seen.opacities[:, None]], 1)
    means, quats, looks = (array[nearest, columns] for array in (means, quats, looks))
    looks[..., 3] *= there
    back = rotations.conjugate(points.quats)
    turns = rotations.multiply(np.broadcast_to(back, quats.shape), quats)
    turns *= np.where(turns[..., :1] < 0, -1, 1)
    shade = looks - np.concatenate([points.sh[:, 0], points.opacities[:, None]], 1)
    return Group(
        index,
        first_frame,
        points,
        means - points.means,
        turns.astype(np.float32),
        alive,
        shade if np.abs(shade).max() > STILL else None,
    )


def _nearest_presence(there: np.ndarray) -> np.ndarray:
    """Return the nearest time at which each point is present, [T, M]. The times of a point are consecutive."""
    times = np.arange(len(there))[:, None]
    start = there.argmax(0)
    end = start + there.sum(0) - 1
    return np.clip(times, start, end)
