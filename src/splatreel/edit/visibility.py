"""Selection of the points that several cameras saw."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from splatreel.edit.clip import Clip, ClipGroup, ClipLayer, shown_points
from splatreel.play.renderers import draw_on_cpu
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import C0, Gaussians
from splatreel.scene.volumes import in_picture

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
    """Selection of the points that at least `least` cameras see: in their pictures, and not behind what is drawn there."""

    def __init__(self, least: int) -> None:
        self.least = least

    def static(self, clip: Clip, index: int, layer: ClipLayer) -> np.ndarray:
        """Return which points of a layer are seen, at the group of its birth."""
        born = clip.outline.layers[index].born
        shown, _, _ = shown_points(clip, born, 0.0)
        return count_cameras(shown, layer.points, clip) >= self.least

    def moving(self, clip: Clip, index: int, group: ClipGroup) -> np.ndarray:
        """Return which dynamic points are seen at one of several moments."""
        seen = np.zeros(len(group.group.dynamic), np.int64)
        for frame in np.unique(np.linspace(0, group.group.frames - 1, MOMENTS).round()).tolist():
            shown, _, _ = shown_points(clip, index, frame)
            seen = np.maximum(seen, count_cameras(shown, group.group.at(frame), clip))
        return (seen >= self.least)[None]


def count_cameras(shown: Gaussians, points: Gaussians, clip: Clip) -> np.ndarray:
    """Return how many of the clip's cameras see each of N points among all that is shown, [N] int64."""
    header, count = clip.outline.header, np.zeros(len(points), np.int64)
    reach = SIZES * points.scales.max(1, initial=0.0)
    for camera in header.cameras:
        drawn = camera.at_most(SIDE)
        inside, pixels, depths = in_picture(points.means, drawn, header.near)
        surface = surface_depth(shown, drawn, header.near, header.antialias)
        columns, rows = (
            np.clip(pixels[:, axis].astype(int), 0, size - 1) for axis, size in ((0, drawn.width), (1, drawn.height))
        )
        count += inside & (depths <= surface[rows, columns] * (1 + BEHIND) + reach)
    return count


def surface_depth(points: Gaussians, camera: Camera, near: float, antialias: bool) -> np.ndarray:
    """Return the mean depth that each pixel shows, [H, W], world units; infinite where hardly anything is drawn."""
    depths = points.means @ camera.viewmat[2, :3] + camera.viewmat[2, 3]
    far = max(float(depths.max(initial=near)), near)
    colors = np.stack([np.clip(depths / far, 0, 1), np.ones_like(depths), np.zeros_like(depths)], 1)
    plain = replace(points, sh=((colors - 0.5) / C0)[:, None])
    image = draw_on_cpu(plain, camera, near, antialias, (0.0, 0.0, 0.0))
    there = image[..., 1] > CLEAR
    return np.where(there, image[..., 0] / np.where(there, image[..., 1], 1) * far, np.inf)
