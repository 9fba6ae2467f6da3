"""Inputs of the stages of a group, for small films."""

import numpy as np

from splatreel.method.cameras.group_input import GroupInput
from splatreel.method.cameras.rig import Rig
from splatreel.method.init.layout import Layout
from splatreel.scene.camera import Camera
from splatreel.scene.clearance import NONE, Clearance
from splatreel.scene.group import GroupSpan


def group_input(
    images: np.ndarray,
    cameras: list[Camera],
    *,
    near: float = 0.01,
    unit: float = 4.0,
    index: int = 0,
    clearance: Clearance = NONE,
    seed: int = 0,
) -> GroupInput:
    """Return the input of a group with images [T, C, H, W, 3], of cameras of which only the poses are known."""
    layout = Layout(near, unit, [0.0, -1, 0], [[-1.0, -1, -1], [1.0, 1, 1]], clearance)
    rig, span = Rig.of(cameras), GroupSpan(index, 0, len(images), len(images))
    return GroupInput(span, images, rig, None, layout, seed, False)
