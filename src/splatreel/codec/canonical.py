"""One of the 24 ways to write a Gaussian: its axes can be exchanged and turned round without a change of its shape."""

from __future__ import annotations

import numpy as np

from splatreel.scene import rotations
from splatreel.scene.gaussians import Gaussians

_EXCHANGES = {
    (0, 1, 2): (1, 0, 0, 0),
    (1, 2, 0): (1, 1, 1, 1),
    (2, 0, 1): (1, -1, -1, -1),
    (1, 0, 2): (0, 1, 1, 0),
    (0, 2, 1): (1, 1, 0, 0),
    (2, 1, 0): (1, 0, -1, 0),
}
"""By which axis comes first, second and third: the rotation that takes the axes there (up to their signs), not normalised."""


def canonical(gaussians: Gaussians) -> tuple[Gaussians, np.ndarray]:
    """The same Gaussians with scales from large to small and w > 0 the largest part of every quaternion.

    Also returns the turns p [N, 4] float64: the new quaternion is the old one times p, and an offset dq of the old point is
    p^-1 dq p of the new one.
    """
    axes = np.argsort(-gaussians.scales, axis=1, kind="stable")
    table = np.zeros((3, 3, 3, 4))
    for exchange, quat in _EXCHANGES.items():
        table[exchange] = quat
    turn = rotations.normalize(table[axes[:, 0], axes[:, 1], axes[:, 2]])
    quats = rotations.multiply(rotations.normalize(gaussians.quats.astype(np.float64)), turn)
    largest = np.abs(quats).argmax(1)
    half = np.eye(4)[largest] * [1, -1, -1, -1]  # a half turn about an axis, or none: brings the largest part to w
    quats, turn = rotations.multiply(quats, half), rotations.multiply(turn, half)
    sign = np.where(quats[:, :1] < 0, -1, 1)
    scales = np.take_along_axis(gaussians.scales, axes, 1)
    return Gaussians(gaussians.means, quats * sign, scales, gaussians.opacities, gaussians.sh), turn * sign


def turned(dq: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Offsets p^-1 dq p [T, N, 4] of offsets dq [T, N, 4] and turns p [N, 4]."""
    return rotations.multiply(rotations.multiply(turn * [1, -1, -1, -1], dq), turn)
