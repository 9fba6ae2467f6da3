"""Removal of points: what lies outside of a volume, and floaters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

import numpy as np

from splatreel.edit.clip import ChangedClip, Clip, ClipGroup, ClipLayer, shown_points
from splatreel.play.timeline import draw_on_cpu
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import C0, Gaussians
from splatreel.scene.volumes import Volume, in_image

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


class _Masked(ChangedClip):
    """Clip in which a mask of each layer, [S] bool, tells what happens to its points. A layer's mask is computed once."""

    def __init__(self, clip: Clip, compute: Callable[[int, ClipLayer], np.ndarray]) -> None:
        super().__init__(clip)
        self._compute = compute
        self._masks: dict[int, np.ndarray] = {}

    def _mask(self, index: int, layer: ClipLayer | None = None) -> np.ndarray:
        if index not in self._masks:
            self._masks[index] = self._compute(index, self._clip.layer(index) if layer is None else layer)
        return self._masks[index]


class Selected(_Masked):
    """Clip with the points that a selection keeps. A dynamic point that is kept at some frames is transparent at the others."""

    def __init__(self, clip: Clip, selection: Selection) -> None:
        super().__init__(clip, lambda index, layer: selection.static(clip, index, layer))
        self._selection = selection

    def change_layer(self, index: int, layer: ClipLayer) -> ClipLayer:
        """Return the kept points of a layer."""
        return layer[self._mask(index, layer)]

    def change_group(self, index: int, found: ClipGroup) -> ClipGroup:
        """Return a group with the kept points."""
        alive = {layer: flags[self._mask(layer)] for layer, flags in found.alive.items()}
        return replace(_keep_at(found, self._selection.moving(self._clip, index, found)), alive=alive)


def _keep_at(found: ClipGroup, kept: np.ndarray) -> ClipGroup:
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


class Erased(_Masked):
    """Clip without the points that are in a volume during some frames.

    Dynamic points are removed from each group in which they are in the volume at one of these frames, static points from
    each group that shows one of these frames.

    Args:
        clip: Source.
        volume: The volume.
        frames: First frame, and the frame after the last.
    """

    def __init__(self, clip: Clip, volume: Volume, frames: tuple[int, int]) -> None:
        super().__init__(clip, lambda _, layer: volume.contains(layer.points.means))
        self._volume = volume
        self._frames = frames

    def change_layer(self, index: int, layer: ClipLayer) -> ClipLayer:
        """Return a layer unchanged, and remember which of its points are in the volume."""
        self._mask(index, layer)
        return layer

    def change_group(self, index: int, found: ClipGroup) -> ClipGroup:
        """Return a group without the points in the volume."""
        span = self.outline.groups[index]
        begin, end = (min(max(frame - span.first_frame, 0), span.frames) for frame in self._frames)
        if begin >= end:
            return found
        alive = {layer: flags & ~self._mask(layer) for layer, flags in found.alive.items()}
        inside = np.asarray(self._volume.contains(found.group.dynamic.means + found.group.dx[begin:end]).any(0))
        return replace(found[~inside], alive=alive)


SIDE = 256
"""Largest side in pixels of the depth images."""
MOMENTS = 3
"""Moments of a group at which dynamic points are looked for."""
BEHIND = 0.05
"""Share of a surface's depth by which a point may be behind the surface and still counts as seen."""
SIZES = 3.0
"""Standard deviations of a point by which it may be behind as well."""
CLEAR = 0.2
"""Opacity of a pixel below which everything in it counts as seen."""


class SeenByCameras:
    """Selection of the points that at least `least` cameras see: in their images, and not behind what is drawn there."""

    def __init__(self, least: int) -> None:
        self.least = least
        self._drawn: dict[tuple[int, float], list[np.ndarray]] = {}

    def static(self, clip: Clip, index: int, layer: ClipLayer) -> np.ndarray:
        """Return which points of a layer are seen, at the group of its birth."""
        return self._count(clip, clip.outline.layers[index].born, 0.0, layer.points) >= self.least

    def moving(self, clip: Clip, index: int, group: ClipGroup) -> np.ndarray:
        """Return which dynamic points are seen at one of several moments."""
        seen = np.zeros(len(group.group.dynamic), np.int64)
        for frame in np.unique(np.linspace(0, group.group.frames - 1, MOMENTS).round()).tolist():
            seen = np.maximum(seen, self._count(clip, index, frame, group.group.at(frame)))
        return (seen >= self.least)[None]

    def _count(self, clip: Clip, index: int, frame: float, points: Gaussians) -> np.ndarray:
        """Return how many of the clip's cameras see each of N points at a frame of a group, [N] int64."""
        near, count = clip.outline.header.near, np.zeros(len(points), np.int64)
        reach = SIZES * points.scales.max(1, initial=0.0)
        for camera, surface in zip(_small(clip), self._surfaces(clip, index, frame), strict=True):
            inside, pixels, depths = in_image(points.means, camera, near)
            columns, rows = (
                np.clip(pixels[:, axis].astype(int), 0, size - 1)
                for axis, size in ((0, camera.width), (1, camera.height))
            )
            count += inside & (depths <= surface[rows, columns] * (1 + BEHIND) + reach)
        return count

    def _surfaces(self, clip: Clip, index: int, frame: float) -> list[np.ndarray]:
        """Return the depth images of the cameras. Those of one group are kept: layers and renditions ask for the same."""
        if (index, frame) not in self._drawn:
            self._drawn = {key: images for key, images in self._drawn.items() if key[0] == index}
            header = clip.outline.header
            shown, _, _ = shown_points(clip, index, frame)
            drawn = [_surface_depth(shown, camera, header.near, header.antialias) for camera in _small(clip)]
            self._drawn[index, frame] = drawn
        return self._drawn[index, frame]


def _small(clip: Clip) -> list[Camera]:
    """Return the clip's cameras at the size of the depth images."""
    return [camera.at_most(SIDE) for camera in clip.outline.header.cameras]


def _surface_depth(points: Gaussians, camera: Camera, near: float, antialias: bool) -> np.ndarray:
    """Return the mean depth that each pixel shows, [H, W], world units; infinite where hardly anything is drawn."""
    depths = points.means @ camera.viewmat[2, :3] + camera.viewmat[2, 3]
    far = max(float(depths.max(initial=near)), near)
    colors = np.stack([np.clip(depths / far, 0, 1), np.ones_like(depths), np.zeros_like(depths)], 1)
    plain = replace(points, sh=((colors - 0.5) / C0)[:, None])
    image = draw_on_cpu(plain, camera, near, antialias, (0.0, 0.0, 0.0))
    there = image[..., 1] > CLEAR
    return np.where(there, image[..., 0] / np.where(there, image[..., 1], 1) * far, np.inf)
