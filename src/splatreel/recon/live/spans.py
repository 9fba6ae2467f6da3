"""The groups of a capture that is still being written: each comes as soon as its frames are there."""

from __future__ import annotations

from collections.abc import Iterator

from splatreel.capture.follower import Follower
from splatreel.scene.spans import GroupSpan, group_spans


class LiveSpans:
    """Iterates over the groups from a number on, until the capture has ended, and waits for their frames.

    A group comes when it is known that its own frames are not the last ones, so that it is cut as `group_spans` would. skip: groups
    but the first that are complete when a later one is, too, are left out, up to the end of the capture.
    """

    def __init__(self, follower: Follower, length: int, overlap: int, first: int, skip: bool = False) -> None:
        self.follower, self.length, self.overlap = follower, length, overlap
        self._next, self._skip = first, skip

    def __iter__(self) -> Iterator[GroupSpan]:
        while (span := self._wait(self._next)) is not None:
            yield span
            self._next = span.index + 1

    def span(self, index: int) -> GroupSpan:
        """A group that is not the last one."""
        return GroupSpan(index, index * self.length, self.length, self.length + self.overlap)

    def complete(self) -> int:
        """How many groups are complete by now, from the first on."""
        total = self.follower.total
        if total is not None:
            return len(group_spans(total, self.length, self.overlap))
        return max((self.follower.frames - 1 - self.overlap) // self.length, 0)

    def behind(self, span: GroupSpan) -> float:
        """Seconds of frames that are there beyond a group's."""
        return max(self.follower.frames - span.first - span.count, 0) / self.follower.capture.fps

    def _wait(self, index: int) -> GroupSpan | None:
        span = self.span(index)
        if self.follower.wait(span.first + span.count + 1):
            if self._skip and index > 0 and self.follower.total is None:
                return self.span(max(self.complete() - 1, index))
            return span
        total = self.follower.total
        if not total:
            return None  # it was stopped, or has nothing
        rest = group_spans(total, self.length, self.overlap)[index:]
        return rest[0] if rest else None
