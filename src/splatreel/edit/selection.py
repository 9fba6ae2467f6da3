"""Removal of points: what lies outside of a volume, and floaters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from splatreel.edit.changed_clip import ChangedClip
from splatreel.edit.clip import Clip, ClipGroup, ClipLayer
from splatreel.scene.volumes import Volume

VISIBLE = 0.5
"""Share of its highest opacity above which a point counts as visible."""


class Selection(Protocol):
    """Rule that keeps some of the points of a clip."""

    def static(self, clip: Clip, index: int, layer: ClipLayer) -> np.ndarray:
        """Return which points of a layer are kept, [S] bool."""
        ...

    def moving(self, clip: Clip, index: int, group: ClipGroup) -> np.ndarray:
        """Return at which frames of a group its dynamic points are kept, [T, N] or [1, N] bool."""
        ...


class Selected(ChangedClip):
    """Clip with the points that a selection keeps. A dynamic point that is kept at some frames is transparent at the others."""

    def __init__(self, clip: Clip, selection: Selection) -> None:
        super().__init__(clip)
        self._selection = selection
        self._kept: dict[int, np.ndarray] = {}

    def change_layer(self, index: int, layer: ClipLayer) -> ClipLayer:
        """Return the kept points of a layer."""
        return layer[self._mask(index, layer)]

    def change_group(self, index: int, found: ClipGroup) -> ClipGroup:
        """Return a group with the kept points."""
        alive = {layer: flags[self._mask(layer)] for layer, flags in found.alive.items()}
        return replace(keep_at(found, self._selection.moving(self._clip, index, found)), alive=alive)

    def _mask(self, index: int, layer: ClipLayer | None = None) -> np.ndarray:
        if index not in self._kept:
            layer = self._clip.layer(index) if layer is None else layer
            self._kept[index] = self._selection.static(self._clip, index, layer)
        return self._kept[index]


def keep_at(found: ClipGroup, kept: np.ndarray) -> ClipGroup:
    """Return a group whose dynamic points show only at some frames, [T, N] or [1, N] bool."""
    some = np.asarray(kept.any(0))
    found, kept = (found, kept) if some.all() else (found[some], kept[:, some])
    if kept.all():
        return found
    group = found.group
    precision = found.precision and found.precision.without_bases("shade")
    return replace(found, group=replace(group, shade=group.shade_where(kept)), precision=precision)


class InVolume:
    """Selection of the points whose centers are in a volume."""

    def __init__(self, volume: Volume) -> None:
        self.volume = volume

    def static(self, clip: Clip, index: int, layer: ClipLayer) -> np.ndarray:
        """Return which points of a layer are inside."""
        return self.volume.contains(layer.points.means)

    def moving(self, clip: Clip, index: int, group: ClipGroup) -> np.ndarray:
        """Return when the dynamic points are inside."""
        return self.volume.contains(group.group.dynamic.means + group.group.dx)


class OpaqueEnough:
    """Selection of the points that reach an opacity."""

    def __init__(self, least: float) -> None:
        self.least = least

    def static(self, clip: Clip, index: int, layer: ClipLayer) -> np.ndarray:
        """Return which points of a layer are opaque enough."""
        return layer.points.opacities >= self.least

    def moving(self, clip: Clip, index: int, group: ClipGroup) -> np.ndarray:
        """Return which dynamic points are opaque enough at some frame."""
        return (group.opacities().max(0) >= self.least)[None]


class SmallEnough:
    """Selection of the points whose largest standard deviation is at most a number of world units."""

    def __init__(self, most: float) -> None:
        self.most = most

    def static(self, clip: Clip, index: int, layer: ClipLayer) -> np.ndarray:
        """Return which points of a layer are small enough."""
        return layer.points.scales.max(1) <= self.most

    def moving(self, clip: Clip, index: int, group: ClipGroup) -> np.ndarray:
        """Return which dynamic points are small enough."""
        return (group.group.dynamic.scales.max(1) <= self.most)[None]


class LastingEnough:
    """Selection of the points that do not appear and disappear within a time. Static points stay.

    A point that is visible at the first or the last frame of its group is kept, because the neighboring groups may show
    the same thing.
    """

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds

    def static(self, clip: Clip, index: int, layer: ClipLayer) -> np.ndarray:
        """Return that all points of a layer are kept."""
        return np.ones(len(layer.points), bool)

    def moving(self, clip: Clip, index: int, group: ClipGroup) -> np.ndarray:
        """Return which dynamic points last long enough."""
        opacities = group.opacities()
        seen = opacities >= VISIBLE * opacities.max(0)
        frames = self.seconds * clip.outline.header.fps
        return (seen[0] | seen[-1] | (seen.sum(0) >= frames))[None]


class Erased(ChangedClip):
    """Clip without the points that are in a volume during some frames.

    Dynamic points are removed from each group in which they are in the volume at one of these frames, static points from
    each group that shows one of these frames.

    Args:
        clip: Source.
        volume: The volume.
        frames: First frame, and the frame after the last.
    """

    def __init__(self, clip: Clip, volume: Volume, frames: tuple[int, int]) -> None:
        super().__init__(clip)
        self._volume = volume
        self._frames = frames
        self._inside: dict[int, np.ndarray] = {}

    def change_layer(self, index: int, layer: ClipLayer) -> ClipLayer:
        """Return a layer unchanged, and remember which of its points are in the volume."""
        self._contained(index, layer)
        return layer

    def change_group(self, index: int, found: ClipGroup) -> ClipGroup:
        """Return a group without the points in the volume."""
        span = self.outline.groups[index]
        begin, end = (min(max(frame - span.first_frame, 0), span.frames) for frame in self._frames)
        if begin >= end:
            return found
        alive = {layer: flags & ~self._contained(layer) for layer, flags in found.alive.items()}
        inside = np.asarray(self._volume.contains(found.group.dynamic.means + found.group.dx[begin:end]).any(0))
        return replace(found[~inside], alive=alive)

    def _contained(self, index: int, layer: ClipLayer | None = None) -> np.ndarray:
        if index not in self._inside:
            layer = self._clip.layer(index) if layer is None else layer
            self._inside[index] = self._volume.contains(layer.points.means)
        return self._inside[index]


def all_of(clip: Clip, selections: Sequence[Selection]) -> Clip:
    """Return the clip with the points that all selections keep."""
    for selection in selections:
        clip = Selected(clip, selection)
    return clip
