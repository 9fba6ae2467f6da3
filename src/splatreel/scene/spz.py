"""Gaussians as SPZ, Niantic's compressed splat file, version 3 (https://github.com/nianticlabs/spz).

gzip around: `u32` magic, `u32` version, `u32` points, `u8` SH degree, `u8` fractional bits, `u8` flags, `u8` 0; then column by column
of the points: positions (3 x 24 bits, fixed point), opacities (u8), base colors (3 x u8), logarithms of scales (3 x u8), rotations
(u32: the three smallest parts), SH coefficients (u8, a coefficient's three channels together).
"""

from __future__ import annotations

import gzip
import math
import struct
from pathlib import Path

import numpy as np

from splatreel.errors import GaussiansError
from splatreel.scene.atomic import write_bytes
from splatreel.scene.gaussians import Gaussians

MAGIC, VERSION = 0x5053474E, 3
_LARGEST = (1 << 23) - 1
_MOST_BITS = 20
_COLOR_SCALE = 0.15
"""Base colors may be out of range where the higher bands bring them back."""
_SH_STEPS = (8, 16, 16)
"""Of the 256 levels, for degrees 1 to 3, as Niantic's writer has them."""
_FLIPPED_SH = np.array([1, -1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1])
"""Signs of the harmonics where y and z point the other way."""


def write_spz(path: str | Path, gaussians: Gaussians, antialias: bool = False) -> None:
    """Write an SPZ file atomically. Axes go from right, down, front, as PLY files of 3DGS have them, to SPZ's right, up, back.

    antialias: they are to be drawn so (`render_image`), which the file's flags tell. Scales keep a step of 6 %, opacities and
    colors 8 bits. Raises `GaussiansError` if the file cannot be written or a point is too far away.
    """
    path = Path(path)
    points = len(gaussians)
    extent = float(np.abs(gaussians.means).max()) if points else 1.0
    bits = min(math.floor(math.log2(_LARGEST / max(extent, 1e-6))), _MOST_BITS)
    if bits < 0:
        raise GaussiansError(
            f"{path}: a point {extent:g} from the origin is too far for an SPZ file. Write a PLY file."
        )
    header = struct.pack("<IIIBBBB", MAGIC, VERSION, points, gaussians.sh_degree, bits, int(antialias), 0)
    flip = np.array([1, -1, -1])
    sh = gaussians.sh * _FLIPPED_SH[None, : gaussians.sh.shape[1], None]
    parts = [
        _fixed(gaussians.means * flip, bits),
        _bytes(gaussians.opacities * 255),
        _bytes((sh[:, 0] * _COLOR_SCALE + 0.5) * 255),
        _bytes((np.log(np.maximum(gaussians.scales, 1e-30)) + 10) * 16),
        _smallest_three(gaussians.quats * np.array([1, 1, -1, -1])),
        _harmonics(sh[:, 1:]),
    ]
    write_bytes(path, gzip.compress(header + b"".join(parts), mtime=0))


def _bytes(values: np.ndarray) -> bytes:
    return np.rint(np.clip(values, 0, 255)).astype(np.uint8).tobytes()


def _fixed(means: np.ndarray, bits: int) -> bytes:
    """[N, 3] as signed whole numbers of 24 bits, low byte first."""
    whole = np.rint(means.astype(np.float64) * (1 << bits)).clip(-_LARGEST, _LARGEST).astype("<i4")
    return whole.reshape(-1, 1).view(np.uint8)[:, :3].tobytes()


def _smallest_three(quats: np.ndarray) -> bytes:
    """[N, 4] wxyz as u32: which of x, y, z, w is largest, then of the others a sign and 9 bits of their size."""
    xyzw = np.roll(quats.astype(np.float64), -1, axis=1)
    largest = np.abs(xyzw).argmax(1)
    xyzw *= np.where(xyzw[np.arange(len(xyzw)), largest] < 0, -1, 1)[:, None]
    sizes = np.minimum(np.rint(np.abs(xyzw) * math.sqrt(2) * 511), 511).astype(np.uint32)
    result = largest.astype(np.uint32)
    for part in range(4):
        code = (xyzw[:, part] < 0).astype(np.uint32) << 9 | sizes[:, part]
        result = np.where(largest == part, result, result << 10 | code)
    return result.astype("<u4").tobytes()


def _harmonics(rest: np.ndarray) -> bytes:
    """[N, K, 3] of -1..1 as bytes of a few levels: fewer make the file smaller."""
    steps = np.repeat(_SH_STEPS, (3, 5, 7))[: rest.shape[1], None]
    levels = np.rint(rest * 128 + 128)
    return _bytes(np.floor((levels + steps // 2) / steps) * steps)
