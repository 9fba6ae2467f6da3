"""Motion layering of one keyframe (paper 4.1): which points are static from here on, and which move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from splatreel.config import LayeringConfig
from splatreel.motion.change import changes
from splatreel.motion.flow import make_flow
from splatreel.motion.lift import lift, shares
from splatreel.motion.masks import make_segmenter, motion_masks
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians


@dataclass(frozen=True)
class Layers:
    """The outcome of layering. alive: [S] bool over the static points there were; settled: new static points; dynamic: the rest."""

    alive: np.ndarray
    settled: Gaussians
    dynamic: Gaussians


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
    return labels > config.label_threshold


def convertible(
    points: Gaussians, cameras: list[Camera], frames: np.ndarray, near: float, least: float, device: torch.device
) -> np.ndarray:
    """Which static points may turn out to move during a group, [N] bool: those that show where pictures change.

    frames: [T, C, H, W, 3] uint8 of the group. least: the share of what a point shows that must lie there. What no camera sees may: it
    can be hidden at the keyframe.
    """
    found = shares(points, cameras, changes(frames), near, device)
    return ~(found < least)  # of NaN, all comparisons are false


def separate(static: Gaussians, alive: np.ndarray, dynamic: Gaussians, moves: np.ndarray) -> Layers:
    """Sort the living static points and the dynamic ones by their labels.

    moves: [A + D] bool, for the A living static points and then the D dynamic ones.
    """
    living = np.flatnonzero(alive)
    static_moves, dynamic_moves = moves[: len(living)], moves[len(living) :]
    still_alive = alive.copy()
    still_alive[living[static_moves]] = False
    woken = static[living[static_moves]]
    return Layers(still_alive, dynamic[~dynamic_moves], Gaussians.concatenate([dynamic[dynamic_moves], woken]))
