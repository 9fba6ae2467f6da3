"""Gaussians as a .splat file: 32 bytes per point, without view-dependent color.

A point is its position and scales (6 x f32), color and opacity (4 x u8), and rotation (4 x u8, wxyz). Viewers draw a
file while it loads, so the points that cover most come first.

Source:
    https://github.com/antimatter15/splat
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from splatreel.base.atomic import write_bytes
from splatreel.scene.gaussians import Gaussians

SPLAT = np.dtype([("means", "<f4", 3), ("scales", "<f4", 3), ("color", "u1", 4), ("turn", "u1", 4)])
"""One point of a file."""


def write_splat(path: str | Path, gaussians: Gaussians) -> None:
    """Write a .splat file atomically.

    Args:
        path: Output file.
        gaussians: Gaussians to write.

    Raises:
        GaussiansError: The file cannot be written.
    """
    points = gaussians[np.argsort(-gaussians.opacities * gaussians.scales.prod(1), kind="stable")]
    table = np.empty(len(points), SPLAT)
    table["means"], table["scales"] = points.means, points.scales
    table["color"] = to_bytes(255 * np.concatenate([points.base_colors, points.opacities[:, None]], 1))
    table["turn"] = to_bytes(128 + 128 * points.quats)
    write_bytes(Path(path), table.tobytes())


def to_bytes(values: np.ndarray) -> np.ndarray:
    """Return values rounded and clamped to 0..255, uint8."""
    return np.rint(np.clip(values, 0, 255)).astype(np.uint8)
