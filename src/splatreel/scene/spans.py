"""A video cut into groups of frames."""

from __future__ import annotations

from dataclasses import dataclass

from splatreel.errors import UsageError


@dataclass(frozen=True)
class GroupSpan:
    """The frames of one group: its own and, unless it is the last, the overlap with the next.

    index: of the group. first: its first frame in the video. own, count: how many frames it has without and with the overlap.
    """

    index: int
    first: int
    own: int
    count: int


def group_spans(frames: int, length: int, overlap: int) -> list[GroupSpan]:
    """Cut a video into groups. A rest no longer than the overlap joins the group before it."""
    if overlap >= length:
        raise UsageError(f"An overlap of {overlap} frames does not fit groups of {length}. Choose a smaller overlap.")
    firsts = [f for f in range(0, frames, length) if f == 0 or frames - f > overlap]
    ends = [*firsts[1:], frames]
    return [
        GroupSpan(i, first, end - first, min(end + overlap, frames) - first)
        for i, (first, end) in enumerate(zip(firsts, ends, strict=True))
    ]
