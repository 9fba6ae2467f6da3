"""Positions as a Draco point cloud in Morton order (QP_DRC).

Draco receives integers, for which its float arithmetic is exact. Every decoder, in any language, then sorts the same
points.

Source:
    Paper, section 4.3.
"""

from __future__ import annotations

import struct
from types import ModuleType

import numpy as np

from splatreel.base.errors import MissingDependencyError, ReelError
from splatreel.codec.quantize import Parameters, integer, number, numbers
from splatreel.scene import morton

_KD_TREE_LEVEL = 10
"""From level 7 Draco encodes point clouds with a kd-tree, about 10 % smaller than sequentially."""


def import_draco() -> ModuleType:
    """Return the module DracoPy. Raise `MissingDependencyError` if it is not installed."""
    try:
        import DracoPy
    except ImportError as error:
        raise MissingDependencyError(
            "The paper's codec (h265) needs DracoPy, which is not installed. Run\n  pip install DracoPy\n"
            "For Windows on ARM there is no DracoPy to install. There, use --codec predictive, the default."
        ) from error
    return DracoPy


def encode_draco(means: np.ndarray, bits: int) -> tuple[bytes, Parameters, np.ndarray]:
    """Encode finite positions [N, 3], N >= 1.

    Returns:
        The section's bytes, its parameters, and order [N]: order[i] is the input point that is decoded as point i.
    """
    if not 4 <= bits <= morton.MAX_BITS:
        raise ReelError(f"Positions of {bits} bits cannot be encoded. Use 4 to {morton.MAX_BITS}.")
    means = np.asarray(means, np.float64)
    low = means.min(0)
    extent = float((means.max(0) - low).max()) or 1.0
    steps = (1 << bits) - 1
    q = _separate(np.rint((means - low) / extent * steps).astype(np.int64), bits)
    order = np.argsort(morton.encode(q), kind="stable")
    data = import_draco().encode(
        q[order].astype(np.float32),  # sorted, so that the bytes do not depend on the input order
        quantization_bits=bits,
        compression_level=_KD_TREE_LEVEL,
        quantization_range=float(steps),
        quantization_origin=[0.0, 0.0, 0.0],
    )
    parameters: Parameters = {"codec": "draco", "bits": bits, "min": low.tolist(), "range": extent}
    if not np.array_equal(_decode_quantized(data, bits, len(means)), q[order]):
        raise ReelError("Draco did not give back the positions it was given. Use another version of DracoPy.")
    return data, parameters, order


def decode_draco(data: bytes, parameters: Parameters, count: int) -> np.ndarray:
    """Decode positions [count, 3] float32 in Morton order. Raise `ReelError` if the section is damaged."""
    bits = integer(parameters, "bits", 4, morton.MAX_BITS)
    low, extent = numbers(parameters, "min", 3), number(parameters, "range", 0, 1e30)
    return (low + _decode_quantized(data, bits, count) * (extent / ((1 << bits) - 1))).astype(np.float32)


def _decode_quantized(data: bytes, bits: int, count: int) -> np.ndarray:
    """Decode integers [count, 3] int64, sorted by Morton code."""
    _check_header(data, count)
    draco = import_draco()
    try:
        positions = np.asarray(draco.decode(data).points)
    except (draco.FileTypeException, draco.EncodingFailedException, ValueError, MemoryError) as error:
        raise ReelError(f"is not a Draco point cloud ({error}).") from error
    if positions.shape != (count, 3) or positions.dtype.kind != "f":
        raise ReelError(f"decodes to positions of shape {positions.shape}, expected ({count}, 3).")
    if not ((positions >= 0) & (positions < 1 << bits) & (positions == np.floor(positions))).all():
        raise ReelError(f"decodes to positions that are not whole numbers of {bits} bits.")
    q = positions.astype(np.int64)
    return q[np.argsort(morton.encode(q), kind="stable")]


def _check_header(data: bytes, count: int) -> None:
    """Refuse anything but a plain point cloud of `count` points before the decoder allocates memory."""
    if len(data) < 15 or data[:5] != b"DRACO":
        raise ReelError("is not a Draco file.")
    kind, _, flags = struct.unpack_from("<BBH", data, 7)
    if kind != 0 or flags & 0x8000:
        raise ReelError("is not a plain Draco point cloud.")
    if len(data) < 21 or data[15] != 1 or data[16] != 1 or data[19] != 3:  # further attributes would take memory
        raise ReelError("is a Draco cloud of more than positions.")
    (points,) = struct.unpack_from("<i", data, 11)
    if points != count:
        raise ReelError(f"is a Draco cloud of {points} points, expected {count}.")


def _separate(q: np.ndarray, bits: int) -> np.ndarray:
    """Move points that share a grid cell to free neighboring cells, because Draco keeps only one of equal points.

    3DGS clones do coincide. A cell is a millionth of the scene, so the move is invisible.
    """
    top = (1 << bits) - 1
    for _ in range(64):
        codes = morton.encode(q)
        by_code = np.argsort(codes, kind="stable")
        ordered = codes[by_code]
        starts = np.flatnonzero(np.r_[True, ordered[1:] != ordered[:-1]])
        if len(starts) == len(q):
            return q
        rank = np.empty(len(q), np.int64)
        rank[by_code] = np.arange(len(q)) - np.repeat(starts, np.diff(np.r_[starts, len(q)]))
        step = morton.decode(rank)
        q = np.where(q + step <= top, q + step, np.maximum(q - step, 0))
    raise ReelError(f"{len(q)} positions do not fit into a lattice of {bits} bits. Use more position bits.")
