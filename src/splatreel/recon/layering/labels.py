"""Motion layering of one keyframe (paper 4.1): which points are static from here on, and which move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splatreel.config import LayeringConfig
from splatreel.motion.change import changes
from splatreel.motion.flow import make_flow
from splatreel.motion.lift import DYNAMIC, lift, shares
from splatreel.motion.light import changes_of_light
from splatreel.motion.masks import make_segmenter, motion_masks
from splatreel.recon.cameras.group_input import GroupInput
from splatreel.recon.init.planesweep import inside, project
from splatreel.recon.layering.relighting import RelitPoints
from splatreel.scene.camera import Camera
from splatreel.scene.clearance import Clearance
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.static_points import StaticPoints


@dataclass(frozen=True)
class Layers:
    """The outcome of layering. alive: [S] bool, static points that stay so; settled: new static points; dynamic: what moves.

    relit: what rests while its light changes, neither static nor moving.
    """

    alive: np.ndarray
    settled: Gaussians
    dynamic: Gaussians
    relit: RelitPoints


def find_layers(data: GroupInput, dynamic: Gaussians, static: StaticPoints, config: LayeringConfig) -> Layers:
    """Which of the points at a keyframe rest in its group, and which move. dynamic: those that are not static so far."""
    data, points = data.smaller(), Gaussians.concatenate([dynamic, static.living])
    moves = label_points(data, points, config)
    if data.span.index:
        moves[: len(dynamic)] |= crowding(dynamic.means, data.cameras, data.layout.clearance)
    light = np.zeros((data.span.count, len(points)), np.float32)
    if config.relighting:
        light[:, ~moves] = changes_of_light(points[~moves], data.cameras, data.images, data.near, data.device)
    return separate(static, dynamic, moves, light)


def label_points(data: GroupInput, points: Gaussians, config: LayeringConfig) -> np.ndarray:
    """[N] bool, which points move during a group. points: as they are at the keyframe."""
    if data.span.count < 2 or len(points) == 0:
        return np.zeros(len(points), bool)
    masks = motion_masks(data.images, make_flow(config.flow), config)
    segmenter = make_segmenter(config.segment)
    if segmenter is not None:
        masks = segmenter.complete(masks, data.images[0])
    if not masks.any():
        return np.zeros(len(points), bool)
    labels = lift(points, data.cameras, masks, data.near, config, data.device)
    return labels > DYNAMIC


def crowding(points: np.ndarray, cameras: list[Camera], clearance: Clearance) -> np.ndarray:
    """[N] bool: points [N, 3] in a camera's picture that it would not be shown if they rested: who has come so near stays dynamic."""
    found = np.zeros(len(points), bool)
    for camera in cameras:
        found |= clearance.hides(points, camera) & inside(camera, project(camera, points)[0])
    return found


def convertible(data: GroupInput, static: StaticPoints, least: float) -> np.ndarray:
    """[S] bool: the static points that may turn out to move during a group: those that show where pictures change.

    least: the share of what a point shows that must lie there; 0: all may. What no camera sees may: it can be hidden at the keyframe.
    """
    if not least:
        return static.alive
    data = data.smaller()
    found = shares(static.living, data.cameras, changes(data.images), data.near, data.device)
    return static.without(found < least).alive  # of NaN, all comparisons are false


def separate(static: StaticPoints, dynamic: Gaussians, moves: np.ndarray, light: np.ndarray) -> Layers:
    """Sort the living static points and the dynamic ones by their labels.

    moves: [D + A] bool, for the D dynamic points and then the A living static ones. light: [T, D + A]
    as in `RelitPoints`, 0 where it stays.
    """
    points = Gaussians.concatenate([dynamic, static.living])
    relit = ~moves & light.any(0)
    rests = ~moves & ~relit
    settled, stays = rests[: len(dynamic)], rests[len(dynamic) :]
    return Layers(
        static.without(~stays).alive, dynamic[settled], points[moves], RelitPoints(points[relit], light[:, relit])
    )
