"""Selection of the points that several cameras saw."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from splatreel.edit.clip import Clip, ClipGroup, ClipLayer, shown_points
from splatreel.play.renderers import draw_on_cpu
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import C0, Gaussians
from splatreel.scene.volumes import in_image

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
            drawn = [surface_depth(shown, camera, header.near, header.antialias) for camera in _small(clip)]
            self._drawn[index, frame] = drawn
        return self._drawn[index, frame]


def _small(clip: Clip) -> list[Camera]:
    """Return the clip's cameras at the size of the depth images."""
    return [camera.at_most(SIDE) for camera in clip.outline.header.cameras]


def surface_depth(points: Gaussians, camera: Camera, near: float, antialias: bool) -> np.ndarray:
    """Return the mean depth that each pixel shows, [H, W], world units; infinite where hardly anything is drawn."""
    depths = points.means @ camera.viewmat[2, :3] + camera.viewmat[2, 3]
    far = max(float(depths.max(initial=near)), near)
    colors = np.stack([np.clip(depths / far, 0, 1), np.ones_like(depths), np.zeros_like(depths)], 1)
    plain = replace(points, sh=((colors - 0.5) / C0)[:, None])
    image = draw_on_cpu(plain, camera, near, antialias, (0.0, 0.0, 0.0))
    there = image[..., 1] > CLEAR
    return np.where(there, image[..., 0] / np.where(there, image[..., 1], 1) * far, np.inf)
