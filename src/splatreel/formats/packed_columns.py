"""Columns of compressed PLY files, as PlayCanvas writes them: packed into integers, in chunks of 256 points."""

from __future__ import annotations

import numpy as np

from splatreel.base.errors import GaussiansError
from splatreel.formats.ply_table import Columns
from splatreel.scene.gaussians import C0

CHUNK = 256
PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
SH_RANGE = 8.0
"""Width of the range of view-dependent color, whose middle is 0."""
_SMALL = np.sqrt(2.0)


def is_packed(columns: Columns) -> bool:
    """Return whether the columns of points are packed."""
    return "packed_position" in columns


def unpack_columns(elements: dict[str, Columns], source: str) -> Columns:
    """Return columns as in a 3DGS PLY file, with logarithms of scales and logits of opacities.

    Args:
        elements: The elements `vertex`, `chunk`, and `sh` if there is view-dependent color. Chunks of older files lack
            the range of colors, which is then 0..1.
        source: Name of the file, for messages.

    Raises:
        GaussiansError: A column is missing, or the numbers of rows do not fit.
    """
    points, chunks, harmonics = (elements.get(name, {}) for name in ("vertex", "chunk", "sh"))
    count = len(points["packed_position"])
    names = [f"{end}_{part}{axis}" for end in ("min", "max") for part in ("", "scale_") for axis in "xyz"]
    fits = all(name in chunks and len(chunks[name]) == -(-count // CHUNK) for name in names)
    whole = all(name in points and points[name].dtype.kind == "u" for name in PACKED)
    if not fits or not whole or any(len(column) != count for column in harmonics.values()):
        raise GaussiansError(f"{source}: is a compressed PLY file with missing parts. Export it again.")
    rows = np.arange(count) // CHUNK
    words = {name: points[name].astype(np.uint64) for name in PACKED}

    def between(share: np.ndarray, low: str, high: str) -> np.ndarray:
        lowest, highest = (np.asarray(chunks[name], np.float64)[rows] for name in (low, high))
        return lowest * (1 - share) + highest * share

    found: Columns = {}
    for axis, shift, bits in (("x", 21, 11), ("y", 11, 10), ("z", 0, 11)):
        found[axis] = between(_share(words["packed_position"], shift, bits), f"min_{axis}", f"max_{axis}")
        scale = _share(words["packed_scale"], shift, bits)
        found[f"scale_{'xyz'.index(axis)}"] = between(scale, f"min_scale_{axis}", f"max_scale_{axis}")
    found |= _rotations(words["packed_rotation"])
    for i, name in enumerate("rgb"):
        color = _share(words["packed_color"], 24 - 8 * i, 8)
        ranged = f"min_{name}" in chunks and f"max_{name}" in chunks
        found[f"f_dc_{i}"] = ((between(color, f"min_{name}", f"max_{name}") if ranged else color) - 0.5) / C0
    with np.errstate(divide="ignore"):
        opacity = _share(words["packed_color"], 0, 8)
        found["opacity"] = np.log(opacity) - np.log1p(-opacity)
    return found | {name: _harmonic(column) for name, column in harmonics.items()}


def _share(words: np.ndarray, shift: int, bits: int) -> np.ndarray:
    """Return some bits of integers [N] as a share of their largest value."""
    most = (1 << bits) - 1
    return ((words >> np.uint64(shift)) & np.uint64(most)).astype(np.float64) / most


def _rotations(words: np.ndarray) -> Columns:
    """Return the columns of quaternions of which the three smaller numbers and the place of the largest are stored."""
    small = np.stack([(_share(words, shift, 10) - 0.5) * _SMALL for shift in (20, 10, 0)], 1)
    largest = np.sqrt(np.maximum(1 - (small**2).sum(1), 0))
    place = (words >> np.uint64(30)).astype(np.int64) & 3
    quats = np.empty((len(words), 4))
    for part in range(4):
        before = np.clip(part - (place < part), 0, 2)
        quats[:, part] = np.where(place == part, largest, small[np.arange(len(words)), before])
    return {f"rot_{i}": quats[:, i] for i in range(4)}


def _harmonic(column: np.ndarray) -> np.ndarray:
    """Return coefficients of view-dependent color, stored as bytes whose ends are exact."""
    share = np.where(column == 255, 1, np.where(column == 0, 0, (column.astype(np.float64) + 0.5) / 256))
    return (share - 0.5) * SH_RANGE
