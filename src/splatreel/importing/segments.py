"""Division of a stretch of frames into segments: points that keep their shape, so that a group stores them once with their motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from splatreel.importing.identity import log_scales
from splatreel.scene.gaussians import Gaussians

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
