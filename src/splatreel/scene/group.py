"""A group of Gaussians (GOG), the content of a reel for one group of frames, and the division of a video into groups and chapters.

Source:
    Paper, section 4.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from splatreel.base.errors import GaussiansError, UsageError
from splatreel.scene.gaussians import Gaussians

MARGIN = 0.25
"""Opacity below zero at frames where a point is hidden, so that the quantization of changes does not show it."""


@dataclass(frozen=True)
class Group:
    """Dynamic Gaussians of a group, their offsets per frame, and the static Gaussians that are alive.

    T is the number of the group's own frames plus the overlap with the next group.

    Attributes:
        index: Number of the group.
        first_frame: First frame of the group in the video.
        dynamic: Canonical Gaussians P^d, at the keyframe unless training moved them.
        dx: Position offsets, [T, N, 3] float32, world units.
        dq: Rotation offsets, [T, N, 4] float32 wxyz, approximately unit.
        alive: Static Gaussians shown by the group, [S] bool. S counts the layers that live at the group, in reel order.
        shade: Change of c_base and opacity, [T, N, 4] float32; None for no change. Not in the paper: for moving
            shadows, flickering flames, and objects that appear or disappear.
        light: Brightness factors of red, green and blue, [T, 3] float32; None for no change. Not in the paper.
    """

    index: int
    first_frame: int
    dynamic: Gaussians
    dx: np.ndarray
    dq: np.ndarray
    alive: np.ndarray
    shade: np.ndarray | None = None
    light: np.ndarray | None = None

    def __post_init__(self) -> None:
        frames, n = self.dx.shape[0], len(self.dynamic)
        if self.dx.shape != (frames, n, 3) or self.dq.shape != (frames, n, 4):
            raise GaussiansError(
                f"Group {self.index}: dx {self.dx.shape} and dq {self.dq.shape} do not fit {n} dynamic points."
            )
        if self.shade is not None and self.shade.shape != (frames, n, 4):
            raise GaussiansError(f"Group {self.index}: shade {self.shade.shape} does not fit {n} dynamic points.")
        if self.light is not None and self.light.shape != (frames, 3):
            raise GaussiansError(f"Group {self.index}: light {self.light.shape} does not fit {frames} frames.")
        if frames < 1:
            raise GaussiansError(f"Group {self.index}: holds no frame.")

    @property
    def frames(self) -> int:
        """Number of frames, including the overlap."""
        return self.dx.shape[0]

    def at(self, frame: float) -> Gaussians:
        """Return the dynamic Gaussians at a frame counted from `first_frame`, without the group's light.

        Frames outside the group are clamped. Between frames, dx and shade are interpolated linearly and dq by
        normalized linear interpolation. The light applies to static Gaussians too, see `light_at`.
        """
        low, high, u = self._between(frame)
        dx = (1 - u) * self.dx[low] + u * self.dx[high]
        a, b = self.dq[low], self.dq[high]
        near = np.where((a * b).sum(-1, keepdims=True) < 0, -b, b)  # take the shorter rotation
        moved = self.dynamic.moved(dx, (1 - u) * a + u * near)
        return moved if self.shade is None else moved.shaded((1 - u) * self.shade[low] + u * self.shade[high])

    def light_at(self, frame: float) -> np.ndarray | None:
        """Return the light [3] at a frame, interpolated and clamped as in `at`, or None for constant light."""
        if self.light is None:
            return None
        low, high, u = self._between(frame)
        return (1 - u) * self.light[low] + u * self.light[high]

    def shade_where(self, shown: np.ndarray) -> np.ndarray:
        """Return the shade with which points show only at some frames.

        Args:
            shown: [T, N] or [1, N] bool.

        Returns:
            [T, N, 4] float32, transparent elsewhere.
        """
        shade = np.zeros((*self.dx.shape[:2], 4), np.float32) if self.shade is None else self.shade.copy()
        shade[..., 3] = np.where(shown, shade[..., 3], -self.dynamic.opacities - MARGIN)
        return shade

    def _between(self, frame: float) -> tuple[int, int, np.float32]:
        """Return the frames before and after a time, and the interpolation weight of the second."""
        frame = float(np.clip(frame, 0, self.frames - 1))
        low = min(int(frame), max(self.frames - 2, 0))
        return low, min(low + 1, self.frames - 1), np.float32(frame - low)


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
