"""A video cut into groups of frames, and these into chapters."""

from __future__ import annotations

import math
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


@dataclass(frozen=True)
class ChapterSpan:
    """The groups of one chapter. index: of the chapter. until: the first group of the next one; None for the last."""

    index: int
    groups: tuple[GroupSpan, ...]
    until: int | None

    @property
    def first(self) -> int:
        """Its first group."""
        return self.groups[0].index


def chapter_spans(groups: list[GroupSpan], frames: int) -> list[ChapterSpan]:
    """Share groups out evenly to chapters of about so many frames each; 0: one chapter. Up to half as many again are one, too."""
    total = sum(group.own for group in groups)
    count = min(max(1, math.ceil(total / frames - 0.5)), len(groups)) if frames else 1
    firsts = [round(index * len(groups) / count) for index in range(count)]
    ends = [*firsts[1:], len(groups)]
    return [
        ChapterSpan(index, tuple(groups[first:end]), end if end < len(groups) else None)
        for index, (first, end) in enumerate(zip(firsts, ends, strict=True))
    ]
