"""Bit quantization, parameters of sections, and the memory that decoding takes.

Floats become integers of few bits with recorded ranges, and integers bytes. Parameters of an untrusted header are checked. The
memory of a file is computed from its header and limited before any allocation (docs/format.md).

Source:
    Paper, section 4.3 and Fig. 6.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping
from typing import Any, Protocol, TypeGuard

import numpy as np

from splatreel.base.errors import ReelError
from splatreel.base.memory_budget import A_BYTE, FLOOR, allowed_memory, in_megabytes

_SOME = 1 << 16
"""Integers unpacked at a time, a multiple of 8. As bits they take eight times their size."""

Parameters = dict[str, Any]
"""A section's entry in the file's header: `codec` and the parameters of that codec."""


def pack(values: np.ndarray, bits: int) -> bytes:
    """Pack integers [K] of `bits` bits (1..16): first the low bytes, then the higher bits without gaps."""
    values = np.ascontiguousarray(values, np.uint16).ravel()
    low = b""
    if bits > 8:
        low = (values & 0xFF).astype(np.uint8).tobytes()
        values, bits = values >> 8, bits - 8
    planes = (values[:, None] >> np.arange(bits, dtype=np.uint16)) & 1
    return low + np.packbits(planes.astype(np.uint8).ravel(), bitorder="little").tobytes()


def packed_size(count: int, bits: int) -> int:
    """Return the number of bytes that `pack` returns for `count` integers."""
    if bits > 8:
        return count + (count * (bits - 8) + 7) // 8
    return (count * bits + 7) // 8


def unpack(data: bytes, bits: int, count: int) -> np.ndarray:
    """Return the integers [count] uint16 that `pack` packed. Raise `ReelError` if the length is wrong."""
    expected = packed_size(count, bits)
    if len(data) != expected:
        raise ReelError(f"holds {len(data)} bytes where {count} integers of {bits} bits need {expected}.")
    low = np.zeros(count, np.uint16)
    shift = 0
    if bits > 8:
        low = np.frombuffer(data, np.uint8, count).astype(np.uint16)
        data, bits, shift = data[count:], bits - 8, 8
    if bits == 8:
        low |= np.frombuffer(data, np.uint8, count).astype(np.uint16) << shift
        return low
    packed, places = np.frombuffer(data, np.uint8), np.arange(bits, dtype=np.uint16) + np.uint16(shift)
    for first in range(0, count, _SOME):
        some = min(_SOME, count - first)
        planes = np.unpackbits(packed[first * bits // 8 :], count=some * bits, bitorder="little").reshape(some, bits)
        low[first : first + some] |= (planes.astype(np.uint16) << places).sum(1, dtype=np.uint16)
    return low


def deflate(data: bytes) -> tuple[bytes, bool]:
    """Return a zlib stream and True, or the data and False if compression does not shorten it."""
    packed = zlib.compress(data, 9)
    return (packed, True) if len(packed) < len(data) else (data, False)


def inflate(data: bytes, parameters: Parameters, size: int) -> bytes:
    """Undo `deflate` as the parameters say. Raise `ReelError` if the result has more than `size` bytes."""
    if not boolean(parameters, "deflate", default=False):
        return data
    stream = zlib.decompressobj()
    try:
        plain = stream.decompress(data, size + 1)
    except zlib.error as error:
        raise ReelError(f"is not a zlib stream ({error}).") from error
    if len(plain) > size or not stream.eof or stream.unused_data:
        raise ReelError(f"does not inflate to the {size} bytes it should hold.")
    return plain


def quantize_columns(values: np.ndarray, steps: int, log: bool) -> tuple[np.ndarray, Parameters]:
    """Return values [N, C] as whole numbers 0..`steps` over the range of each column, and these ranges."""
    columns = np.asarray(values, np.float64)
    if log:
        columns = np.log2(np.maximum(columns, np.finfo(np.float32).tiny))
    low, high = columns.min(0), columns.max(0)
    q = np.rint((columns - low) / np.where(high > low, high - low, 1) * steps)
    ranges: Parameters = {"min": low.tolist(), "max": high.tolist()}
    return q, ranges | ({"log": True} if log else {})


def encode_linear(values: np.ndarray, bits: int, log: bool = False) -> tuple[bytes, Parameters]:
    """Quantize each column of values [N, C] over its own range. `log` quantizes log2 of positive values."""
    q, ranges = quantize_columns(values, (1 << bits) - 1, log)
    data, packed = deflate(pack(q.T, bits))
    return data, {"codec": "linear", "bits": bits} | ranges | {"deflate": packed}


def decode_linear(data: bytes, parameters: Parameters, rows: int, columns: int) -> np.ndarray:
    """Decode the values [rows, columns] float32 of a `linear` section. Raise `ReelError` if it is damaged."""
    bits = integer(parameters, "bits", 1, 16)
    low, high = numbers(parameters, "min", columns), numbers(parameters, "max", columns)
    if (high < low).any():
        raise ReelError(f"has a range whose min {low.tolist()} is above its max {high.tolist()}.")
    plain = inflate(data, parameters, packed_size(rows * columns, bits))
    q = unpack(plain, bits, rows * columns).reshape(columns, rows)
    log = boolean(parameters, "log", default=False)
    if log and ((np.abs(low) > 126).any() or (np.abs(high) > 126).any()):
        raise ReelError(f"has logarithms {low.tolist()}..{high.tolist()} that no float32 holds.")
    values = np.empty((rows, columns), np.float32)
    for column, step in enumerate((high - low) / ((1 << bits) - 1)):
        exact = low[column] + q[column] * step
        values[:, column] = np.exp2(exact) if log else exact
    return values


def encode_float32(values: np.ndarray) -> tuple[bytes, Parameters]:
    """Encode values of any shape as a `float32` section, in C order."""
    return np.ascontiguousarray(values, "<f4").tobytes(), {"codec": "float32"}


def decode_float32(data: bytes, shape: tuple[int, ...]) -> np.ndarray:
    """Decode the finite values of a `float32` section. Raise `ReelError` if it is damaged."""
    expected = 4 * math.prod(shape)
    if len(data) != expected:
        raise ReelError(f"holds {len(data)} bytes where float32 numbers of shape {shape} need {expected}.")
    values = np.frombuffer(data, "<f4").reshape(shape)
    if not np.isfinite(values).all():
        raise ReelError("holds NaN or infinity.")
    return values.astype(np.float32)


def encode_bits(flags: np.ndarray) -> tuple[bytes, Parameters]:
    """Encode flags [S] bool as a `bits` section."""
    data, packed = deflate(pack(flags, 1))
    return data, {"codec": "bits", "count": len(flags), "deflate": packed}


def decode_bits(data: bytes, parameters: Parameters, max_count: int) -> np.ndarray:
    """Decode the flags [count] bool of a `bits` section. Raise `ReelError` if it is damaged."""
    count = integer(parameters, "count", 0, max_count)
    plain = inflate(data, parameters, packed_size(count, 1))
    if len(plain) != packed_size(count, 1):
        raise ReelError(f"holds {len(plain)} bytes where {count} flags need {packed_size(count, 1)}.")
    return np.unpackbits(np.frombuffer(plain, np.uint8), count=count, bitorder="little").view(bool)


def integer(parameters: Parameters, name: str, low: int, high: int) -> int:
    """Return an integer parameter in low..high. Raise `ReelError` if it is anything else."""
    value = parameters.get(name)
    if not is_whole(value) or not low <= value <= high:
        raise ReelError(f"has {name} = {_short(value)}, expected a whole number from {low} to {high}.")
    return int(value)


def is_whole(value: object) -> TypeGuard[float]:
    """Return whether a JSON value is a whole number. JSON does not tell 4 from 4.0."""
    return not isinstance(value, bool) and isinstance(value, int | float) and value % 1 == 0


def boolean(parameters: Parameters, name: str, default: bool | None = None) -> bool:
    """Return a boolean parameter. Raise `ReelError` if it is anything else, or missing without a default."""
    value = parameters.get(name, default)
    if not isinstance(value, bool):
        raise ReelError(f"has {name} = {_short(value)}, expected true or false.")
    return value


def number(parameters: Parameters, name: str, low: float, high: float) -> float:
    """Return a finite number in low..high. Raise `ReelError` if it is anything else."""
    value = parameters.get(name)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not low <= value <= high:
        raise ReelError(f"has {name} = {_short(value)}, expected a number from {low:g} to {high:g}.")
    return float(value)


def numbers(parameters: Parameters, name: str, count: int) -> np.ndarray:
    """Return a list of `count` numbers within float32 as [count] float64. Raise `ReelError` if it is anything else."""
    value = parameters.get(name)
    if not isinstance(value, list) or len(value) != count:
        raise ReelError(f"has {name} = {_short(value)}, expected {count} numbers.")
    for item in value:
        if isinstance(item, bool) or not isinstance(item, (int, float)) or not -3e38 <= item <= 3e38:
            raise ReelError(f"has {name} = {_short(value)}, expected {count} finite numbers.")
    return np.array(value, np.float64)


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


MOST_FRAMES = 10_000
"""Maximum number of frames of a group."""
_MAX_OFFSETS = 1 << 26
"""Maximum number of frames times points of a group."""
_POINT, _VALUE, _COEFFICIENT, _COLOR, _BASIS, _PIXEL = 256, 32, 6, 6, 32, 2
"""Bytes of memory per point, per point and frame, per `klt` coefficient, per `sh_rest` number, per basis number and per map pixel."""


class Coded(Protocol):
    """Section described by its parameters."""

    @property
    def parameters(self) -> dict[str, Any]:
        """Parameters of the section."""
        ...


def claimed_memory(points: int, frames: int, sections: Mapping[str, Coded]) -> int:
    """Return the bytes of memory that decoding a file takes.

    Args:
        points: Points of the file.
        frames: Frames of the group; 0 for a layer.
        sections: Sections by name. Invalid parameters count as 0; the decoders refuse them later.
    """
    found = {name: section.parameters for name, section in sections.items()}
    a_point = _POINT + _VALUE * frames * (2 if "shade" in found else 1)
    a_point += _COEFFICIENT * max((_whole(p, "columns") for p in found.values() if p.get("codec") == "klt"), default=0)
    basis = max((len(p["shifts"]) for p in found.values() if isinstance(p.get("shifts"), list)), default=0)
    degree = min(_whole(found.get("sh_rest", {}), "degree"), 3)
    a_point += _COLOR * 3 * ((degree + 1) ** 2 - 1)
    images = sum(_area(p) * (10 * frames if name == "offsets" else 3) for name, p in found.items())
    images += _area(found.get("sh_rest", {})) * 3 * (degree + 1) ** 2
    flags = _whole(found.get("alive", {}), "count")
    return points * a_point + _BASIS * basis * max(frames, 45) + _PIXEL * images + 2 * flags


def check_memory(points: int, frames: int, sections: Mapping[str, Coded], size: int, most: int | None = None) -> None:
    """Raise `ReelError` if decoding a file takes too much memory.

    Args:
        points: Points of the file.
        frames: Frames of the group; 0 for a layer.
        sections: Sections by name.
        size: Length of the file in bytes.
        most: Memory limit in bytes; None uses `allowed_memory(size)`.
    """
    limit, needed = allowed_memory(size) if most is None else most, claimed_memory(points, frames, sections)
    if needed > limit:
        what = f"{frames} frames of {points}" if frames else f"{points}"
        raise ReelError(
            f"claims {what} points in {size} bytes: decoding it would take {in_megabytes(needed)} MB of memory, more than the "
            f"{in_megabytes(limit)} MB that are allowed. If you trust it, allow more: `most`, or --max-memory {in_megabytes(needed)}."
        )


def missing_bytes(points: int, frames: int, sections: Mapping[str, Coded], size: int) -> int:
    """Return how many bytes of padding a file of `size` bytes needs for its memory to be allowed. Usually 0."""
    return max(-(-(claimed_memory(points, frames, sections) - allowed_memory(size)) // A_BYTE), 0)


def most_points(size: int) -> int:
    """Return the maximum number of points in files of `size` bytes together."""
    return size + FLOOR // A_BYTE


def _whole(parameters: Mapping[str, Any], name: str) -> int:
    value = parameters.get(name)
    return int(value) if is_whole(value) and 0 <= value <= 1 << 26 else 0


def _area(parameters: Mapping[str, Any]) -> int:
    return _whole(parameters, "width") * _whole(parameters, "height")


def check_offsets(dx: np.ndarray, dq: np.ndarray) -> None:
    """Raise `ReelError` if offsets dx [T, N, 3] or dq [T, N, 4] are not finite or too many for a group."""
    if not (np.isfinite(dx).all() and np.isfinite(dq).all()):
        raise ReelError("Offsets hold NaN or infinity and cannot be encoded.")
    if dx.shape[0] * dx.shape[1] > _MAX_OFFSETS:
        raise ReelError(f"{dx.shape[1]} points x {dx.shape[0]} frames are too many offsets. Make shorter groups.")


def check_offset_count(frames: int, points: int) -> None:
    """Raise `ReelError` if a file claims more offsets than a group may have."""
    if not 1 <= frames <= MOST_FRAMES or frames * points > _MAX_OFFSETS:
        raise ReelError(f"claims {frames} frames of {points} points, more than can be decoded.")
