"""Gaussians as SPZ, Niantic's compressed splat file, versions 2 to 4.

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
from pathlib import Path
from typing import Literal

import numpy as np

from splatreel.base.atomic import write_bytes
from splatreel.base.command_line import install_command
from splatreel.base.errors import GaussiansError
from splatreel.formats.splat import to_bytes
from splatreel.scene.gaussians import Gaussians

MAGIC = 0x5053474E
Version = Literal[2, 3, 4]
_HEADER, _LEVEL = 32, 12
"""Bytes of the header of version 4, and its zstd level."""
_LARGEST = (1 << 23) - 1
_MOST_BITS = 20
COLOR_SCALE = 0.15
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
        GaussiansError: The file cannot be written, a point is too far away, or a package is missing.
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
        _bytes((sh[:, 0] * COLOR_SCALE + 0.5) * 255),
        _bytes((np.log(np.maximum(gaussians.scales, 1e-30)) + 10) * 16),
        _smallest_three(gaussians.quats) if version > 2 else _first_three(gaussians.quats),
        _harmonics(sh[:, 1:]),
    ]
    write_bytes(path, _streams(path, header, parts) if version > 3 else _one_stream(header, parts))


def _one_stream(header: bytes, parts: list[bytes]) -> bytes:
    return gzip.compress(header + bytes(1) + b"".join(parts), mtime=0)


def _streams(path: Path, header: bytes, parts: list[bytes]) -> bytes:
    """Return a file of version 4."""
    try:
        import zstandard  # pyright: ignore[reportMissingImports] - optional
    except ImportError as error:
        raise GaussiansError(
            f"{path}: SPZ version 4 needs a package. Run\n  {install_command('splats')}\nor write version 3."
        ) from error
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
