"""Groups of frames: stretches with the same points, points that are far away, and the layers of a group."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from splatreel.codec.predictive.points import MAX_BITS
from splatreel.codec.predictive.precision import STEPS, coarsest_class
from splatreel.config import EncodeConfig
from splatreel.importing.identity import log_scales
from splatreel.importing.viewpoints import visible_positions
from splatreel.scene import rotations
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group

SHELL = 16.0
"""Ratio of the distances of the farthest and the nearest point of a layer of far points."""
STEADY = 1e-3
"""A far point is static if it moves by less than this share of its distance."""
STEADY_COLOR = 0.02
"""Maximum change of color and opacity of a static far point."""


@dataclass(frozen=True)
class Reach:
    """Region whose points can share a layer without a coarser quantization step.

    Attributes:
        middle: Middle of the region, [3] float64.
        radius: Half of its width, world units.
    """

    middle: np.ndarray
    radius: float

    @staticmethod
    def of(points: Gaussians, config: EncodeConfig) -> Reach:
        """Return the region around the median of points."""
        size = float(np.exp(np.median(np.log(np.maximum(points.scales, 1e-30)))))
        step = STEPS.position * config.coarseness * size * 2 ** coarsest_class(config.coarseness)
        return Reach(np.median(visible_positions(points), axis=0), step * ((1 << MAX_BITS) - 1) / 2)

    def shells(self, points: Gaussians) -> np.ndarray:
        """Return the layer of each point, [N] int: 0 within the region, then higher by distance."""
        distance = self._distance(points)
        return np.ceil(np.log(np.maximum(distance / self.radius, 1)) / np.log(SHELL)).astype(np.int64)

    def steady(self, reference: Gaussians, points: Gaussians) -> np.ndarray:
        """Return which points are far and look the same, [N] bool."""
        moved = np.linalg.norm(points.means - reference.means, axis=1)
        color = np.abs(points.sh[:, 0] - reference.sh[:, 0]).max(1, initial=0.0)
        alike = np.maximum(color, np.abs(points.opacities - reference.opacities)) <= STEADY_COLOR
        distance = self._distance(reference)
        return (distance > self.radius) & (moved <= STEADY * distance) & alike

    def _distance(self, points: Gaussians) -> np.ndarray:
        return np.abs(points.means - self.middle).max(1, initial=0.0)


SCALE = 0.1
"""Maximum difference of a scale's logarithm from the segment's first frame."""
MAX_SH_CHANGE = 0.05
"""Maximum difference of a view-dependent color coefficient from the segment's first frame."""
MAX_SHIFT, MAX_TURN, MAX_COLOR_CHANGE = 0.03, 0.01, 0.004
"""Maximum changes of a static point: share of the point's mean scale; sine of half the angle; color or opacity, 0..1."""
MANY = 1.5
"""Maximum segments per point of an average frame in a group. With more segments, shorter groups are smaller."""


@dataclass(frozen=True)
class Segments:
    """S segments of T frames.

    Attributes:
        rows: Row of each segment's point in each frame, [T, S] int64; -1 where absent. The frames of a segment are
            consecutive.
        numbers: Number of each point, [S], see `Identities`.
        unchanged: Segments present in all frames without any change, [S] bool.
    """

    rows: np.ndarray
    numbers: np.ndarray
    unchanged: np.ndarray


class SegmentBuilder:
    """Builder of segments from the frames of a stretch."""

    def __init__(self) -> None:
        self.frames: list[Gaussians] = []
        self.opened: list[int] = []
        self._rows: list[np.ndarray] = []
        self._numbers = np.zeros(0, np.int64)
        self._unchanged_frames = np.zeros(0, np.int64)
        self._reference: Gaussians | None = None

    def add(self, points: Gaussians, numbers: np.ndarray) -> None:
        """Add a frame. `numbers` [N] are the numbers of its points."""
        segment = np.full(len(points), -1)
        if self._reference is not None:
            last = self._rows[-1]
            going = np.flatnonzero(last >= 0)
            _, mine, theirs = np.intersect1d(numbers, self._numbers[going], assume_unique=True, return_indices=True)
            some = going[theirs]
            fits = _keeps_shape(self._reference[some], points[mine])
            mine, some = mine[fits], some[fits]
            segment[mine] = some
            still = is_unchanged(self._reference[some], points[mine]) & (
                self._unchanged_frames[some] == len(self.frames)
            )
            self._unchanged_frames[some] += still
        new = np.flatnonzero(segment < 0)
        begin = len(self._numbers)
        segment[new] = np.arange(begin, begin + len(new))
        self._numbers = np.concatenate([self._numbers, numbers[new]])
        # A segment that starts later is never unchanged for the whole stretch.
        self._unchanged_frames = np.concatenate([self._unchanged_frames, np.full(len(new), 0 if self.frames else 1)])
        if self._reference is None:
            self._reference = points
        elif len(new):
            self._reference = Gaussians.concatenate([self._reference, points[new]])
        rows = np.full(len(self._numbers), -1)
        rows[segment] = np.arange(len(points))
        self._rows.append(rows)
        self.frames.append(points)
        self.opened.append(len(self._numbers))

    def cut(self, most: int) -> int:
        """Return the number of frames for a group, at most `most`, halved until it has few segments for its points."""
        length = min(most, len(self.frames))
        while length > 1:
            points = np.mean([len(frame) for frame in self.frames[:length]])
            if self.opened[length - 1] <= MANY * points:
                return length
            length = (length + 1) // 2
        return 1

    def first(self, length: int) -> Segments:
        """Return the segments of the first `length` frames."""
        count = self.opened[length - 1]
        rows = np.full((length, count), -1)
        for frame, some in enumerate(self._rows[:length]):
            rows[frame, : min(len(some), count)] = some[:count]
        unchanged = (self._unchanged_frames[:count] >= length) & (length > 1)
        return Segments(rows, self._numbers[:count], unchanged)


def stretch(frames: Sequence[tuple[Gaussians, np.ndarray]]) -> SegmentBuilder:
    """Return a builder filled with frames and the numbers of their points."""
    builder = SegmentBuilder()
    for points, numbers in frames:
        builder.add(points, numbers)
    return builder


def _keeps_shape(reference: Gaussians, points: Gaussians) -> np.ndarray:
    """Return where the values that a group stores once are visually equal, [N] bool."""
    scales = np.abs(log_scales(points) - log_scales(reference)).max(1) <= SCALE
    rest = np.abs(points.sh[:, 1:] - reference.sh[:, 1:]).max((1, 2), initial=0.0)
    return scales & (rest <= MAX_SH_CHANGE)


def is_unchanged(reference: Gaussians, points: Gaussians) -> np.ndarray:
    """Return where points neither move, rotate, nor change color or opacity visibly, [N] bool."""
    size = np.exp(log_scales(reference).mean(1))
    place = np.linalg.norm(points.means - reference.means, axis=1) <= MAX_SHIFT * size
    cosine = np.abs((points.quats * reference.quats).sum(1))
    turn = 1 - np.minimum(cosine, 1) ** 2 <= MAX_TURN**2
    color = np.abs(points.sh[:, 0] - reference.sh[:, 0]).max(1, initial=0.0) <= MAX_COLOR_CHANGE
    return place & turn & color & (np.abs(points.opacities - reference.opacities) <= MAX_COLOR_CHANGE)


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
