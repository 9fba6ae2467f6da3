"""Division of a video into groups of frames and into chapters."""

from __future__ import annotations

import math
from dataclasses import dataclass

from splatreel.base.errors import UsageError


@dataclass(frozen=True)
class GroupSpan:
    """Frames of one group.

    Attributes:
        index: Number of the group.
        first: First frame in the video.
        own: Number of frames without the overlap.
        count: Number of frames with the overlap. The last group has no overlap.
    """

    index: int
    first: int
    own: int
    count: int


def group_spans(frames: int, length: int, overlap: int) -> list[GroupSpan]:
    """Divide a video into groups. A remainder no longer than the overlap joins the group before it.

    Args:
        frames: Frames of the video.
        length: Frames per group.
        overlap: Frames shared with the next group.

    Raises:
        UsageError: The overlap is not shorter than a group.
    """
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
    """Groups of one chapter.

    Attributes:
        index: Number of the chapter.
        groups: Groups of the chapter.
        until: Number of the next chapter's first group; None for the last chapter.
    """

    index: int
    groups: tuple[GroupSpan, ...]
    until: int | None

    @property
    def first(self) -> int:
        """Number of the chapter's first group."""
        return self.groups[0].index


def chapter_spans(groups: list[GroupSpan], frames: int) -> list[ChapterSpan]:
    """Divide groups evenly into chapters.

    Args:
        groups: All groups.
        frames: Target frames per chapter; 0 makes one chapter. Videos of up to 1.5 times as many frames stay one
            chapter.
    """
    total = sum(group.own for group in groups)
    count = min(max(1, math.ceil(total / frames - 0.5)), len(groups)) if frames else 1
    firsts = [round(index * len(groups) / count) for index in range(count)]
    ends = [*firsts[1:], len(groups)]
    return [
        ChapterSpan(index, tuple(groups[first:end]), end if end < len(groups) else None)
        for index, (first, end) in enumerate(zip(firsts, ends, strict=True))
    ]
