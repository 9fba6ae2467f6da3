"""Reader of .ksplat, the format of GaussianSplats3D: sections of points, whose positions may be relative to buckets.

A file has a header of 4,096 bytes, a header of 1,024 bytes per section, then the sections. A section has the sizes of its
last buckets, which are not full, then the centers of all buckets, then the points.

Source:
    https://github.com/mkkellogg/GaussianSplats3D
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatreel.base.errors import GaussiansError
from splatreel.base.memory_budget import UNRAISED, MemoryBudget, points_memory
from splatreel.base.ply_table import Columns
from splatreel.base.untrusted import naming_damage, read_file
from splatreel.formats.splat_columns import concatenate_columns, logit, name_columns
from splatreel.scene.gaussians import C0

MOST_BYTES, MOST_SECTIONS = 1 << 34, 1 << 16
_HEADER, _SECTION = 4096, 1024
_COMPONENTS = (0, 9, 24, 45)
"""View-dependent color components by SH degree."""
_BANDS = (3, 5, 7)
_STEPS = 32767
_RANGE = 1.5


@dataclass(frozen=True)
class _Header:
    sections: int
    count: int
    level: int
    lowest: float
    highest: float

    def point(self, degree: int) -> np.dtype:
        """Return the layout of a point."""
        center, number = ("<f4", "<f4") if self.level == 0 else ("<u2", "<f2")
        rest = ("<f4", "<f2", "u1")[self.level]
        fields = [("means", center, 3), ("scales", number, 3), ("turn", number, 4), ("color", "u1", 4)]
        return np.dtype([*fields, ("rest", rest, _COMPONENTS[degree])])


def read_ksplat(path: Path, budget: MemoryBudget = UNRAISED) -> Columns:
    """Return columns as in a 3DGS PLY file, with logarithms of scales and logits of opacities.

    Raises:
        GaussiansError: The file is damaged, of another version, or takes too much memory.
    """
    data = read_file(path, MOST_BYTES, GaussiansError)
    with naming_damage(str(path), GaussiansError, "a damaged .ksplat file", "Export it again."):
        header = _parse_header(data)
        points, degree = _claimed_points(data, header)
        needed = len(data) + points_memory(points, _COMPONENTS[degree])
        budget.check(needed, len(data), str(path), f"{points:,} points of degree {degree}")
        start, parts = _HEADER + _SECTION * header.sections, []
        for section in range(header.sections):
            columns, start = _read_section(data, _HEADER + _SECTION * section, start, header)
            parts.append(columns)
    return concatenate_columns(parts)


def _parse_header(data: bytes) -> _Header:
    major, minor = struct.unpack_from("<BB", data)
    sections, count, level = (struct.unpack_from(kind, data, at)[0] for kind, at in (("<I", 4), ("<I", 16), ("<H", 20)))
    lowest, highest = struct.unpack_from("<ff", data, 36)
    if (major, level > 2, minor < 1) != (0, False, False) or sections > MOST_SECTIONS:
        raise ValueError(f"version {major}.{minor}, compression {level}, {sections} sections")
    return _Header(sections, count, level, lowest or -_RANGE, highest or _RANGE)


def _claimed_points(data: bytes, header: _Header) -> tuple[int, int]:
    """Return the number of points of all sections, and their highest degree."""
    points = highest = 0
    for section in range(header.sections):
        at = _HEADER + _SECTION * section
        count, room = struct.unpack_from("<2I", data, at)
        degree = struct.unpack_from("<H", data, at + 40)[0]
        if degree >= len(_COMPONENTS) or not count <= room:
            raise ValueError(f"{count} of {room} points of degree {degree}")
        points, highest = points + count, max(highest, degree)
    if points * header.point(0).itemsize > len(data):
        raise ValueError(f"{points} points in {len(data)} bytes")
    return points, highest


def _read_section(data: bytes, at: int, start: int, header: _Header) -> tuple[Columns, int]:
    count, room, capacity, buckets = struct.unpack_from("<4I", data, at)
    block, storage = struct.unpack_from("<fH", data, at + 16)
    steps = struct.unpack_from("<I", data, at + 24)[0] or _STEPS
    full, partial, degree = struct.unpack_from("<IIH", data, at + 32)
    if buckets and storage < 12:
        raise ValueError(f"buckets of {storage} bytes")
    kind = header.point(degree)
    places = start + 4 * partial
    points_at = places + storage * buckets
    table = np.frombuffer(data, kind, count, points_at)
    means = table["means"].astype(np.float64)
    if header.level:
        if full + partial > buckets:
            raise ValueError(f"{full + partial} of {buckets} buckets are used")
        centers = np.frombuffer(data, np.uint8, storage * buckets, places).reshape(buckets, storage)
        centers = np.ascontiguousarray(centers[:, :12]).view("<f4")
        sizes = np.concatenate([np.full(full, capacity), np.frombuffer(data, "<u4", partial, start)])
        bucket = np.searchsorted(np.cumsum(sizes.astype(np.int64)), np.arange(count), side="right")
        if count and bucket[-1] >= buckets:
            raise ValueError(f"buckets hold {sizes.sum()} of {count} points")
        means = (means - steps) * (block / 2 / steps) + centers[bucket]
    return _columns(table, means, degree, header), points_at + kind.itemsize * room


def _columns(table: np.ndarray, means: np.ndarray, degree: int, header: _Header) -> Columns:
    scales = np.log(np.maximum(table["scales"].astype(np.float64), 1e-30))
    rest = table["rest"].astype(np.float64)
    if header.level == 2:
        rest = header.lowest + rest / 255 * (header.highest - header.lowest)
    first, harmonics = 0, [np.zeros((len(table), 0, 3))]
    for band in _BANDS[:degree]:  # it has its red components, then green, then blue
        part = rest[:, 3 * first : 3 * (first + band)].reshape(len(table), 3, band)
        harmonics.append(part.transpose(0, 2, 1))
        first += band
    base, turns = (table["color"][:, :3] / 255 - 0.5) / C0, table["turn"].astype(np.float64)
    opacity = logit(table["color"][:, 3] / 255)
    return name_columns(means, scales, turns, base, opacity, np.concatenate(harmonics, 1))
