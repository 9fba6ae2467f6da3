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
from splatreel.base.errors import GaussiansError
from splatreel.base.memory_budget import MemoryBudget, points_memory
from splatreel.base.ply_table import Columns
from splatreel.base.untrusted import read_file
from splatreel.formats.splat_columns import name_columns
from splatreel.scene.gaussians import C0, Gaussians

MOST_BYTES = 1 << 34
_POINT = np.dtype([("means", "<f4", 3), ("scales", "<f4", 3), ("color", "u1", 4), ("turn", "u1", 4)])
"""One point of a file."""


def write_splat(path: str | Path, gaussians: Gaussians) -> None:
    """Write a .splat file atomically.

    `path`: Output file.

    Raises:
        StorageError: The file cannot be written.
    """
    points = gaussians[np.argsort(-gaussians.opacities * gaussians.scales.prod(1), kind="stable")]
    table = np.empty(len(points), _POINT)
    table["means"], table["scales"] = points.means, points.scales
    table["color"] = to_bytes(255 * np.concatenate([points.base_colors, points.opacities[:, None]], 1))
    table["turn"] = to_bytes(128 + 128 * points.quats)
    write_bytes(Path(path), table.tobytes())


def to_bytes(values: np.ndarray) -> np.ndarray:
    """Return values rounded and clamped to 0..255, uint8."""
    return np.rint(np.clip(values, 0, 255)).astype(np.uint8)


def read_splat(path: Path, budget: MemoryBudget) -> Columns:
    """Return the columns of a .splat file: 32 bytes per point, without view-dependent color."""
    data = read_file(path, MOST_BYTES, GaussiansError)
    if len(data) % _POINT.itemsize:
        raise GaussiansError(f"{path}: has {len(data)} bytes, no multiple of {_POINT.itemsize}. Copy it again.")
    count = len(data) // _POINT.itemsize
    budget.check(len(data) + points_memory(count), len(data), str(path), f"{count:,} points")
    table = np.frombuffer(data, _POINT)
    base = (table["color"][:, :3] / 255 - 0.5) / C0
    quats = (table["turn"].astype(np.float64) - 128) / 128
    scales = np.log(np.maximum(table["scales"], np.finfo(np.float32).tiny))
    return name_columns(table["means"], scales, quats, base, table["color"][:, 3])
