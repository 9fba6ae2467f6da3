"""Segments as what a reel stores: static points, and a group of moving ones."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from splatreel.scene import rotations
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group
from splatreel.sequence.segments import Segments, rests

FEWEST = 100
"""Points that a layer has at least: fewer are not worth a file, and count as moving."""
STILL = 1e-3
"""Changes of color and opacity below this are none."""


class StaticLayers:
    """The static points of a reel so far, of all its layers, and which point of the film each is.

    points: [S], as they were read, in reel order.
    """

    def __init__(self, sh_degree: int) -> None:
        self.points = Gaussians.empty(sh_degree)
        self._row_of = np.zeros(0, np.int64)

    def split(self, frame: Gaussians, segments: Segments) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """alive [S] bool, which of the static points a stretch shows; the segments [B] that are born now; and those [M] that move.

        frame: the first of the stretch. A point that rests is static if it is already, or if enough of them become so together.
        """
        resting = np.flatnonzero(segments.rests)
        points = frame[segments.rows[0, resting]]
        row = self._rows(segments.numbers)[resting]
        known = row >= 0
        known[known] = rests(self.points[row[known]], points[known])
        alive = np.zeros(len(self.points), bool)
        alive[row[known]] = True
        born = resting[~known]
        if len(born) < FEWEST:
            born = born[:0]
        static = np.concatenate([resting[known], born])
        return alive, born, np.setdiff1d(np.arange(len(segments.numbers)), static)

    def add(self, points: Gaussians, numbers: np.ndarray) -> None:
        """Those of a layer, in the order of its file; where it holds a point that an earlier one does, too, it takes its place."""
        self._rows(numbers)
        self._row_of[numbers] = np.arange(len(self.points), len(self.points) + len(points))
        self.points = Gaussians.concatenate([self.points, points])

    def _rows(self, numbers: np.ndarray) -> np.ndarray:
        """[N]: the row of `points` that each one of these is, -1 for none."""
        missing = numbers.max(initial=-1) + 1 - len(self._row_of)
        if missing > 0:
            self._row_of = np.concatenate([self._row_of, np.full(missing, -1)])
        return self._row_of[numbers]


def group_of(index: int, first_frame: int, frames: Sequence[Gaussians], rows: np.ndarray, alive: np.ndarray) -> Group:
    """The group that shows moving points: rows [T, M] of them in its frames [T], -1 where a point is not there, and so not seen.

    Each is stored as it is when it first appears; before and after, it stays where it is, with an opacity of 0.
    """
    there = rows >= 0
    if not rows.shape[1]:
        empty = np.zeros((len(frames), 0, 4), np.float32)
        return Group(index, first_frame, frames[0][:0], empty[..., :3], empty, alive)
    nearest = _nearest(there)
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
    back = points.quats * np.array([1, -1, -1, -1], np.float32)
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


def _nearest(there: np.ndarray) -> np.ndarray:
    """[T, M]: for each time the nearest at which a point is there, whose times are consecutive."""
    times = np.arange(len(there))[:, None]
    start = there.argmax(0)
    end = start + there.sum(0) - 1
    return np.clip(times, start, end)
