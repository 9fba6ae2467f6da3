"""Motion layering at a keyframe (paper section 4.1): separation of static, dynamic and relit points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splatreel.config import LayeringConfig
from splatreel.method.cameras.group_input import GroupInput
from splatreel.method.images.change import changed_pixels
from splatreel.method.images.flow import make_flow
from splatreel.method.layering.lift import DYNAMIC_LABEL, lift, shares
from splatreel.method.layering.light_changes import changes_of_light
from splatreel.method.layering.masks import make_segmenter, motion_masks
from splatreel.scene.camera import Camera, inside, project
from splatreel.scene.clearance import Clearance
from splatreel.scene.gaussians import C0, Gaussians, StaticPoints


@dataclass(frozen=True)
class RelitPoints:
    """Points without motion, and the change of their light.

    Attributes:
        points: M points at the keyframe.
        light: [T, M] logarithm of each point's brightness at every frame, relative to the keyframe.
    """

    points: Gaussians
    light: np.ndarray

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.points)

    @property
    def shades(self) -> np.ndarray:
        """Change of c_base at every frame, [T, M, 3] float32."""
        return self._shade(self.light)

    @property
    def tracks(self) -> np.ndarray:
        """Positions at every frame, [T, M, 3] float32."""
        return np.repeat(self.points.means[None], len(self.light), 0)

    def at(self, frame: int) -> Gaussians:
        """Return the points with the colors they have at a frame."""
        return self.points.shaded(np.pad(self._shade(self.light[frame]), ((0, 0), (0, 1))))

    def _shade(self, light: np.ndarray) -> np.ndarray:
        """Return the change of c_base, [..., M, 3] float32, for a change of light [..., M]."""
        color = np.maximum(self.points.base_colors, 0)
        return (np.expm1(light)[..., None] * (color / C0)).astype(np.float32)


@dataclass(frozen=True)
class Layers:
    """Result of motion layering.

    Attributes:
        alive: [S] bool, static points that stay static.
        new_static: Dynamic points that become static.
        dynamic: Points that move during the group.
        relit: Points without motion whose light changes. They belong to the group, but are not tracked.
    """

    alive: np.ndarray
    new_static: Gaussians
    dynamic: Gaussians
    relit: RelitPoints


def find_layers(data: GroupInput, dynamic: Gaussians, static: StaticPoints, config: LayeringConfig) -> Layers:
    """Separate the points at a keyframe into static, dynamic and relit ones.

    Args:
        data: Training views of the group.
        dynamic: Points that are not static so far.
        static: Static points.
        config: Layering settings.
    """
    data, points = data.smaller(), Gaussians.concatenate([dynamic, static.living])
    moves = label_points(data, points, config)
    if data.span.index:
        moves[: len(dynamic)] |= near_cameras(dynamic.means, data.cameras, data.layout.clearance)
    light = np.zeros((data.span.count, len(points)), np.float32)
    if config.relighting:
        light[:, ~moves] = changes_of_light(points[~moves], data.cameras, data.images, data.near)
    return separate(static, dynamic, moves, light)


def label_points(data: GroupInput, points: Gaussians, config: LayeringConfig) -> np.ndarray:
    """Return [N] bool, the points that move during a group.

    Args:
        data: Training views of the group.
        points: N points at the keyframe.
        config: Layering settings.
    """
    if not config.enabled:
        return np.ones(len(points), bool)
    if data.span.count < 2 or len(points) == 0:
        return np.zeros(len(points), bool)
    masks = motion_masks(data.images, make_flow(config.flow), config)
    segmenter = make_segmenter(config.segment)
    if segmenter is not None:
        masks = segmenter.complete(masks, data.images[0])
    if not masks.any():
        return np.zeros(len(points), bool)
    labels = lift(points, data.cameras, masks, data.near, config)
    return labels > DYNAMIC_LABEL


def near_cameras(points: np.ndarray, cameras: list[Camera], clearance: Clearance) -> np.ndarray:
    """Return [N] bool, the points that a camera sees but that clearance would hide from it if they were static.

    Points this close to a camera stay dynamic, so that they are drawn.

    Args:
        points: [N, 3] positions.
        cameras: Training cameras.
        clearance: Depth in front of a viewer within which no static point is drawn.
    """
    found = np.zeros(len(points), bool)
    for camera in cameras:
        found |= clearance.hides(points, camera) & inside(camera, project(camera, points)[0])
    return found


def convertible(data: GroupInput, static: StaticPoints, least: float) -> np.ndarray:
    """Return [S] bool, the static points that adaptive conversion may make dynamic.

    A point that no camera sees may be converted, since it can be hidden at the keyframe.

    Args:
        data: Training views of the group.
        static: Static points.
        least: Minimum share of a point's contribution that must lie in pixels that change during the group; 0 allows all
            points.
    """
    if not least:
        return static.alive
    data = data.smaller()
    found = shares(static.living, data.cameras, changed_pixels(data.images), data.near)
    return static.without(found < least).alive  # unseen points are NaN, which compares false


def separate(static: StaticPoints, dynamic: Gaussians, moves: np.ndarray, light: np.ndarray) -> Layers:
    """Sort dynamic and living static points by their labels.

    Args:
        static: Static points, A of them living.
        dynamic: D dynamic points.
        moves: [D + A] bool, for the dynamic and then the living static points.
        light: [T, D + A] change of light as in `RelitPoints`; 0 means no change.
    """
    points = Gaussians.concatenate([dynamic, static.living])
    relit = ~moves & light.any(0)
    unmoved = ~moves & ~relit
    new_static, stays = unmoved[: len(dynamic)], unmoved[len(dynamic) :]
    return Layers(
        static.without(~stays).alive, dynamic[new_static], points[moves], RelitPoints(points[relit], light[:, relit])
    )
