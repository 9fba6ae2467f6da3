"""Reader of SPZ, Niantic's compressed format, versions 1 to 4 (`formats/spz.py` describes versions 2 to 4).

Source:
    https://github.com/nianticlabs/spz
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatreel.base.command_line import install_command
from splatreel.base.errors import GaussiansError
from splatreel.base.memory_budget import UNRAISED, MemoryBudget, points_memory
from splatreel.base.untrusted import open_regular, read_file
from splatreel.formats.ply_table import Columns
from splatreel.formats.spz import COLOR_SCALE, MAGIC

MOST_POINTS, MOST_BYTES = 10_000_000, 1 << 34
_BANDS = (0, 3, 8, 15, 24)
_ANTIALIASED = 1
_GZIP, _START = b"\x1f\x8b", 1 << 12
"""First bytes of a gzip stream, and bytes of a file that hold the header."""


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

    Args:
        path: Input file.
        budget: Memory that reading may take.

    Raises:
        GaussiansError: The file is damaged, of another version, or takes too much memory.
    """
    data = read_file(path, MOST_BYTES, GaussiansError)
    try:
        header = _first_header(data)
        coefficients = 3 * _BANDS[header.degree]
        needed = sum(header.sizes()) + points_memory(header.count, coefficients)
        budget.check(needed, len(data), str(path), f"{header.count:,} points of degree {header.degree}")
        parts = _unpack_gzip(data, header) if data[:2] == _GZIP else _unpack_zstd(data, header, path)
    except (ValueError, struct.error, zlib.error, EOFError) as error:
        raise GaussiansError(f"{path}: is a damaged SPZ file ({error!s:.80}). Export it again.") from error
    return _columns(header, [np.frombuffer(part, np.uint8) for part in parts])


def is_spz_antialiased(path: Path) -> bool:
    """Return whether the points are marked as trained with antialiasing. Raises as `read_spz` does."""
    try:
        with open_regular(path, GaussiansError) as file:
            return bool(_first_header(file.read(_START)).flags & _ANTIALIASED)
    except OSError as error:
        raise GaussiansError(f"{path}: cannot be read ({error.strerror}).") from error
    except (ValueError, struct.error, zlib.error) as error:
        raise GaussiansError(f"{path}: is a damaged SPZ file ({error!s:.80}). Export it again.") from error


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
    try:
        import zstandard  # pyright: ignore[reportMissingImports] - optional
    except ImportError as error:
        raise GaussiansError(
            f"{path}: is SPZ version 4, and needs a package. Run\n  {install_command('splats')}"
        ) from error
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
    quats = _smallest_three(turns.view("<u4")) if header.version >= 3 else _first_three(turns.reshape(count, 3))
    with np.errstate(divide="ignore"):
        opacity = np.log(alphas / 255) - np.log1p(-(alphas / 255))
    base = (colors.reshape(count, 3) / 255 - 0.5) / COLOR_SCALE
    sizes = scales.reshape(count, 3) / 16 - 10
    rest = harmonics.reshape(count, bands, 3) / 128 - 1
    found = dict(zip("xyz", means.T, strict=True)) | {"opacity": opacity}
    found |= {f"scale_{i}": sizes[:, i] for i in range(3)} | {f"f_dc_{i}": base[:, i] for i in range(3)}
    found |= {f"rot_{i}": quats[:, i] for i in range(4)}
    return found | {f"f_rest_{bands * c + i}": rest[:, i, c] for c in range(3) for i in range(bands)}


def _first_three(turns: np.ndarray) -> np.ndarray:
    """Return quaternions [N, 4] wxyz of versions 1 and 2: x, y, z as bytes, w positive."""
    xyz = turns / 127.5 - 1
    w = np.sqrt(np.maximum(1 - (xyz**2).sum(1, keepdims=True), 0))
    return np.concatenate([w, xyz], 1)


def _smallest_three(codes: np.ndarray) -> np.ndarray:
    """Return quaternions [N, 4] wxyz of version 3 and later, whose last number is in the lowest bits."""
    place, left = (codes >> 30).astype(np.int64), codes.astype(np.int64)
    xyzw = np.zeros((len(codes), 4))
    for part in (3, 2, 1, 0):
        stored = place != part
        value = np.where(left >> 9 & 1, -1, 1) * (left & 511) / 511 / np.sqrt(2)
        xyzw[:, part] = np.where(stored, value, 0)
        left = np.where(stored, left >> 10, left)
    xyzw[np.arange(len(codes)), place] = np.sqrt(np.maximum(1 - (xyzw**2).sum(1), 0))
    return np.roll(xyzw, 1, axis=1)
