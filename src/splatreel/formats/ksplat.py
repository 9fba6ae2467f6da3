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
from splatreel.base.untrusted import read_file
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
    try:
        header = _parse_header(data)
        points, degree = _claimed_points(data, header)
        needed = len(data) + points_memory(points, _COMPONENTS[degree])
        budget.check(needed, len(data), str(path), f"{points:,} points of degree {degree}")
        start, parts = _HEADER + _SECTION * header.sections, []
        for section in range(header.sections):
            columns, start = _read_section(data, _HEADER + _SECTION * section, start, header)
            parts.append(columns)
    except (ValueError, IndexError, struct.error) as error:
        raise GaussiansError(f"{path}: is a damaged .ksplat file ({error!s:.80}). Export it again.") from error
    names = max(parts, key=len, default={})
    return {
        name: np.concatenate([part.get(name, np.zeros(len(part["x"]))) for part in parts]).astype(np.float64)
        for name in names
    }


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
    alpha = table["color"][:, 3] / 255
    with np.errstate(divide="ignore"):
        opacity = np.log(alpha) - np.log1p(-alpha)
    scales = np.log(np.maximum(table["scales"].astype(np.float64), 1e-30))
    rest = table["rest"].astype(np.float64)
    if header.level == 2:
        rest = header.lowest + rest / 255 * (header.highest - header.lowest)
    found = dict(zip("xyz", means.T, strict=True)) | {"opacity": opacity}
    found |= {f"scale_{i}": scales[:, i] for i in range(3)}
    found |= {f"f_dc_{i}": (table["color"][:, i] / 255 - 0.5) / C0 for i in range(3)}
    found |= {f"rot_{i}": table["turn"][:, i].astype(np.float64) for i in range(4)}
    bands = sum(_BANDS[:degree])
    first = 0  # a band has its red components, then green, then blue
    for band in _BANDS[:degree]:
        for i in range(3 * band):
            found[f"f_rest_{bands * (i // band) + first + i % band}"] = rest[:, 3 * first + i]
        first += band
    return found
