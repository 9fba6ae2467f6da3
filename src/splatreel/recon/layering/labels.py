"""Motion layering of one keyframe (paper 4.1): which points are static from here on, and which move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from splatreel.config import LayeringConfig
from splatreel.motion.change import changes
from splatreel.motion.flow import make_flow
from splatreel.motion.lift import DYNAMIC, lift, shares
from splatreel.motion.masks import make_segmenter, motion_masks
from splatreel.recon.init.planesweep import inside, project
from splatreel.recon.layering.relighting import RelitPoints
from splatreel.scene.camera import Camera
from splatreel.scene.clearance import Clearance
from splatreel.scene.gaussians import Gaussians


@dataclass(frozen=True)
class Layers:
    """The outcome of layering. alive: [S] bool over the static points there were; settled: new static points; dynamic: what moves.

    lit: what rests while its light changes, neither static nor moving.
    """

    alive: np.ndarray
    settled: Gaussians
    dynamic: Gaussians
    lit: RelitPoints


def label_points(
    points: Gaussians,
    cameras: list[Camera],
    frames: np.ndarray,
    near: float,
    config: LayeringConfig,
    device: torch.device,
) -> np.ndarray:
    """Which points move during a group, [N] bool.

    points: as they are at the keyframe; frames: [T, C, H, W, 3] uint8 of the group, the keyframe first.
    """
    if len(frames) < 2 or len(points) == 0:
        return np.zeros(len(points), bool)
    masks = motion_masks(frames, make_flow(config.flow), config)
    segmenter = make_segmenter(config.segment)
    if segmenter is not None:
        masks = segmenter.complete(masks, frames[0])
    if not masks.any():
        return np.zeros(len(points), bool)
    labels = lift(points, cameras, masks, near, config, device)
    return labels > DYNAMIC


def crowding(points: np.ndarray, cameras: list[Camera], clearance: Clearance) -> np.ndarray:
    """[N] bool: points [N, 3] in a camera's picture that it would not be shown if they rested: who has come so near stays dynamic."""
    found = np.zeros(len(points), bool)
    for camera in cameras:
        found |= clearance.hides(points, camera) & inside(camera, project(camera, points)[0])
    return found


def convertible(
    points: Gaussians, cameras: list[Camera], frames: np.ndarray, near: float, least: float, device: torch.device
) -> np.ndarray:
    """Which static points may turn out to move during a group, [N] bool: those that show where pictures change.

    frames: [T, C, H, W, 3] uint8 of the group. least: the share of what a point shows that must lie there. What no camera sees may: it
    can be hidden at the keyframe.
    """
    found = shares(points, cameras, changes(frames), near, device)
    return ~(found < least)  # of NaN, all comparisons are false


def separate(static: Gaussians, alive: np.ndarray, dynamic: Gaussians, moves: np.ndarray, light: np.ndarray) -> Layers:
    """Sort the living static points and the dynamic ones by their labels.

    moves: [D + A] bool, for the D dynamic points and then the A living static ones. light: [T, D + A]
    as in `RelitPoints`, 0 where it stays.
    """
    everything = Gaussians.concatenate([dynamic, static[alive]])
    lit = ~moves & light.any(0)
    stays = ~moves & ~lit
    still_alive = alive.copy()
    still_alive[alive] = stays[len(dynamic) :]
    return Layers(
        still_alive, dynamic[stays[: len(dynamic)]], everything[moves], RelitPoints(everything[lit], light[:, lit])
    )
