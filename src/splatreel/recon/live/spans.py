"""Groups of a capture that is still being written."""

from __future__ import annotations

from collections.abc import Iterator

from splatreel.capture.follower import Follower
from splatreel.scene.spans import GroupSpan, group_spans


class LiveSpans:
    """Iterator over the groups of a growing capture. It waits for their frames until the capture ends.

    A group is yielded once at least one later frame exists, so that spans equal those of `group_spans`.

    Attributes:
        follower: The growing capture.
        length: Frames of a group.
        overlap: Frames shared with the next group.
    """

    def __init__(self, follower: Follower, length: int, overlap: int, first: int, skip: bool = False) -> None:
        """Prepare the iteration.

        Args:
            follower: The growing capture.
            length: Frames of a group.
            overlap: Frames shared with the next group.
            first: Number of the first group.
            skip: Skip groups if a later one is complete already. Group 0 and the groups after the end of the capture are never
                skipped.
        """
        self.follower, self.length, self.overlap = follower, length, overlap
        self._next, self._skip = first, skip

    def __iter__(self) -> Iterator[GroupSpan]:
        """Yield groups as their frames arrive."""
        while (span := self._wait(self._next)) is not None:
            yield span
            self._next = span.index + 1

    def span(self, index: int) -> GroupSpan:
        """Return the span of a group that is not the last one."""
        return GroupSpan(index, index * self.length, self.length, self.length + self.overlap)

    def complete_count(self) -> int:
        """Return the number of groups that are complete so far."""
        total = self.follower.total
        if total is not None:
            return len(group_spans(total, self.length, self.overlap))
        return max((self.follower.frames - 1 - self.overlap) // self.length, 0)

    def seconds_behind(self, span: GroupSpan) -> float:
        """Return the seconds of video that exist after the end of a group."""
        return max(self.follower.frames - span.first - span.count, 0) / self.follower.capture.fps

    def _wait(self, index: int) -> GroupSpan | None:
        span = self.span(index)
        if self.follower.wait(span.first + span.count + 1):
            if self._skip and index > 0 and self.follower.total is None:
                return self.span(max(self.complete_count() - 1, index))
            return span
        total = self.follower.total
        if not total:
            return None  # stopped, or empty
        rest = group_spans(total, self.length, self.overlap)[index:]
        return rest[0] if rest else None
