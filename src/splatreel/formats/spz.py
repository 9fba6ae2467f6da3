"""SPZ, Niantic's compressed splat file: a reader of versions 1 to 4, and a writer of versions 2 to 4.

The content is: `u32` magic, `u32` version, `u32` points, `u8` SH degree, `u8` fractional bits, `u8` flags, `u8` 0. Then
follow the columns: positions (3 x 24 bits, fixed point), opacities (u8), base colors (3 x u8), logarithms of scales (3 x
u8), rotations (u32, three smallest components), SH coefficients (u8, the three channels of a coefficient together).
Version 2 stores rotations as x, y, z (3 x u8). Versions 2 and 3 are one gzip stream. Version 4 has a header of 32 bytes,
the sizes of the columns, and a zstd stream per column.

Source:
    https://github.com/nianticlabs/spz
"""

from __future__ import annotations

import gzip
import math
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from splatreel.base.atomic import write_bytes
from splatreel.base.errors import GaussiansError
from splatreel.base.memory_budget import UNRAISED, MemoryBudget, points_memory
from splatreel.base.ply_table import Columns
from splatreel.base.untrusted import naming_damage, open_regular, read_file
from splatreel.formats.compressed_ply import from_smallest_three
from splatreel.formats.splat import to_bytes
from splatreel.formats.splat_columns import import_for_splats, logit, name_columns
from splatreel.scene.gaussians import Gaussians

MAGIC = 0x5053474E
Version = Literal[2, 3, 4]
_HEADER, _LEVEL = 32, 12
"""Bytes of the header of version 4, and its zstd level."""
_LARGEST = (1 << 23) - 1
_MOST_BITS = 20
_COLOR_SCALE = 0.15
"""Base colors may be out of range if higher bands compensate for it."""
_SH_STEPS = (8, 16, 16)
"""Quantization steps of degrees 1 to 3, out of 256 levels, as in Niantic's writer."""


def write_spz(path: str | Path, gaussians: Gaussians, antialias: bool = False, version: Version = 3) -> None:
    """Write an SPZ file atomically.

    The axes of an SPZ file are right, up, back: y points up. Scales are stored in steps of 6 %, opacities and colors
    with 8 bits.

    Args:
        path: Output file.
        gaussians: Gaussians to write, in the axes of the file.
        antialias: Value of the antialiasing flag, as for `render_image`.
        version: Version of the format.

    Raises:
        GaussiansError: A point is too far away, or a package is missing.
        StorageError: The file cannot be written.
    """
    path = Path(path)
    points = len(gaussians)
    extent = float(np.abs(gaussians.means).max()) if points else 1.0
    bits = min(math.floor(math.log2(_LARGEST / max(extent, 1e-6))), _MOST_BITS)
    if bits < 0:
        raise GaussiansError(
            f"{path}: a point {extent:g} from the origin is too far for an SPZ file. Write a PLY file."
        )
    header = struct.pack("<IIIBBB", MAGIC, version, points, gaussians.sh_degree, bits, int(antialias))
    sh = gaussians.sh
    parts = [
        _fixed(gaussians.means, bits),
        _bytes(gaussians.opacities * 255),
        _bytes((sh[:, 0] * _COLOR_SCALE + 0.5) * 255),
        _bytes((np.log(np.maximum(gaussians.scales, 1e-30)) + 10) * 16),
        _smallest_three(gaussians.quats) if version > 2 else _first_three(gaussians.quats),
        _harmonics(sh[:, 1:]),
    ]
    write_bytes(path, _streams(path, header, parts) if version > 3 else _one_stream(header, parts))


def _one_stream(header: bytes, parts: list[bytes]) -> bytes:
    return gzip.compress(header + bytes(1) + b"".join(parts), mtime=0)


def _streams(path: Path, header: bytes, parts: list[bytes]) -> bytes:
    """Return a file of version 4."""
    zstandard = import_for_splats("zstandard", f"{path}: SPZ version 4, unlike 3,")
    parts = [part for part in parts if part]
    packed = [zstandard.ZstdCompressor(_LEVEL).compress(part) for part in parts]
    table = struct.pack(
        f"<{2 * len(parts)}Q",
        *(size for pair in zip(packed, parts, strict=True) for size in map(len, pair)),
    )
    start = (header + struct.pack("<BI", len(parts), _HEADER)).ljust(_HEADER, b"\0")
    return start + table + b"".join(packed)


def _bytes(values: np.ndarray) -> bytes:
    return to_bytes(values).tobytes()


def _fixed(means: np.ndarray, bits: int) -> bytes:
    """Encode positions [N, 3] as signed 24-bit integers, low byte first."""
    whole = np.rint(means.astype(np.float64) * (1 << bits)).clip(-_LARGEST, _LARGEST).astype("<i4")
    return whole.reshape(-1, 1).view(np.uint8)[:, :3].tobytes()


def _smallest_three(quats: np.ndarray) -> bytes:
    """Encode quaternions [N, 4] wxyz as u32: index of the largest of x, y, z, w, then sign and 9 bits of each other component."""
    xyzw = np.roll(quats.astype(np.float64), -1, axis=1)
    largest = np.abs(xyzw).argmax(1)
    xyzw *= np.where(xyzw[np.arange(len(xyzw)), largest] < 0, -1, 1)[:, None]
    sizes = np.minimum(np.rint(np.abs(xyzw) * math.sqrt(2) * 511), 511).astype(np.uint32)
    result = largest.astype(np.uint32)
    for part in range(4):
        code = (xyzw[:, part] < 0).astype(np.uint32) << 9 | sizes[:, part]
        result = np.where(largest == part, result, result << 10 | code)
    return result.astype("<u4").tobytes()


def _first_three(quats: np.ndarray) -> bytes:
    """Encode quaternions [N, 4] wxyz with positive w as x, y, z in bytes."""
    xyz = quats[:, 1:] * np.where(quats[:, :1] < 0, -1, 1)
    return _bytes(xyz * 127.5 + 127.5)


def _harmonics(rest: np.ndarray) -> bytes:
    """Encode SH coefficients [N, K, 3] of -1..1 as bytes with few levels, which compress better."""
    steps = np.repeat(_SH_STEPS, (3, 5, 7))[: rest.shape[1], None]
    levels = np.rint(rest * 128 + 128)
    return _bytes(np.floor((levels + steps // 2) / steps) * steps)


MOST_POINTS, MOST_BYTES = 10_000_000, 1 << 34
_BANDS = (0, 3, 8, 15, 24)
_ANTIALIASED = 1
_GZIP, _START = b"\x1f\x8b", 1 << 12
"""First bytes of a gzip stream, and bytes of a file that hold the header."""
_DAMAGED = "a damaged SPZ file", "Export it again."


@dataclass(frozen=True)
class _Header:
    version: int
    count: int
    degree: int
    bits: int
    flags: int

    def sizes(self) -> list[int]:
        """Return the bytes of positions, opacities, colors, scales, rotations and harmonics."""
        place, turn = (6 if self.version == 1 else 9), (3 if self.version < 3 else 4)
        return [self.count * size for size in (place, 1, 3, 3, turn, 3 * _BANDS[self.degree])]


def read_spz(path: Path, budget: MemoryBudget = UNRAISED) -> Columns:
    """Return columns as in a 3DGS PLY file, with logarithms of scales and logits of opacities, in the axes of SPZ.

    Raises:
        GaussiansError: The file is damaged, of another version, or takes too much memory.
    """
    data = read_file(path, MOST_BYTES, GaussiansError)
    with naming_damage(str(path), GaussiansError, *_DAMAGED):
        header = _first_header(data)
        coefficients = 3 * _BANDS[header.degree]
        needed = sum(header.sizes()) + points_memory(header.count, coefficients)
        budget.check(needed, len(data), str(path), f"{header.count:,} points of degree {header.degree}")
        parts = _unpack_gzip(data, header) if data[:2] == _GZIP else _unpack_zstd(data, header, path)
    return _columns(header, [np.frombuffer(part, np.uint8) for part in parts])


def is_spz_antialiased(path: Path) -> bool:
    """Return whether the points are marked as trained with antialiasing. Raises as `read_spz` does."""
    with naming_damage(str(path), GaussiansError, *_DAMAGED), open_regular(path, GaussiansError) as file:
        return bool(_first_header(file.read(_START)).flags & _ANTIALIASED)


def _first_header(data: bytes) -> _Header:
    """Return the header at the start of a file, which versions 1 to 3 pack."""
    return _parse_header(zlib.decompressobj(31).decompress(data[:_START], 16) if data[:2] == _GZIP else data)


def _parse_header(data: bytes) -> _Header:
    magic, *fields = struct.unpack_from("<IIIBBB", data)
    header = _Header(*fields)
    if magic != MAGIC or not 1 <= header.version <= 4:
        raise ValueError(f"version {header.version}")
    if header.count > MOST_POINTS or header.degree >= len(_BANDS) or header.bits > 31:
        raise ValueError(f"{header.count} points of degree {header.degree} with {header.bits} bits")
    return header


def _unpack_gzip(data: bytes, header: _Header) -> list[bytes]:
    stream = zlib.decompressobj(31)
    stream.decompress(data, 16)
    size = sum(header.sizes())
    plain = stream.decompress(stream.unconsumed_tail, size + 1)
    if len(plain) < size or header.version > 3:
        raise ValueError(f"{len(plain)} of {size} bytes")
    ends = np.cumsum(header.sizes()).tolist()
    return [plain[end - length : end] for end, length in zip(ends, header.sizes(), strict=True)]


def _unpack_zstd(data: bytes, header: _Header, path: Path) -> list[bytes]:
    streams, at = struct.unpack_from("<BI", data, 15)
    sizes = [size for size in header.sizes() if size]
    if header.version != 4 or streams != len(sizes):
        raise ValueError(f"{streams} streams")
    zstandard = import_for_splats("zstandard", f"{path}: SPZ version 4")
    table = struct.unpack_from(f"<{2 * streams}Q", data, at)
    start, parts = at + 16 * streams, []
    for packed, size in zip(table[::2], sizes, strict=True):
        try:
            stream = data[start : start + packed]
            if (claimed := zstandard.frame_content_size(stream)) not in (-1, size):  # it would be allocated
                raise ValueError(f"{claimed} of {size} bytes")
            part = zstandard.ZstdDecompressor().decompress(stream, max_output_size=size)
        except zstandard.ZstdError as error:
            raise ValueError(str(error)) from error
        if len(part) != size:
            raise ValueError(f"{len(part)} of {size} bytes")
        parts.append(part)
        start += packed
    return [*parts, *([b""] * (6 - len(parts)))]


def _columns(header: _Header, parts: list[np.ndarray]) -> Columns:
    count, bands = header.count, _BANDS[header.degree]
    places, alphas, colors, scales, turns, harmonics = parts
    if header.version == 1:
        means = places.view("<f2").reshape(count, 3).astype(np.float64)
    else:
        words = places.reshape(count, 3, 3).astype(np.int64) @ [1, 1 << 8, 1 << 16]
        means = (words - (words >> 23 << 24)) / (1 << header.bits)
    quats = (
        _unpack_smallest_three(turns.view("<u4"))
        if header.version >= 3
        else _unpack_first_three(turns.reshape(count, 3))
    )
    base = (colors.reshape(count, 3) / 255 - 0.5) / _COLOR_SCALE
    sizes = scales.reshape(count, 3) / 16 - 10
    rest = harmonics.reshape(count, bands, 3) / 128 - 1
    return name_columns(means, sizes, quats, base, logit(alphas / 255), rest)


def _unpack_first_three(turns: np.ndarray) -> np.ndarray:
    """Return quaternions [N, 4] wxyz of versions 1 and 2: x, y, z as bytes, w positive."""
    xyz = turns / 127.5 - 1
    w = np.sqrt(np.maximum(1 - (xyz**2).sum(1, keepdims=True), 0))
    return np.concatenate([w, xyz], 1)


def _unpack_smallest_three(codes: np.ndarray) -> np.ndarray:
    """Return quaternions [N, 4] wxyz of version 3 and later, whose last number is in the lowest bits."""
    words = codes.astype(np.int64)
    fields = np.stack([words >> shift & 1023 for shift in (20, 10, 0)], 1)
    small = np.where(fields >> 9, -1, 1) * (fields & 511) / 511 / np.sqrt(2)
    return np.roll(from_smallest_three(words >> 30, small), 1, axis=1)
