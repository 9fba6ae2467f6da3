"""Bit quantization: floats to integers of few bits with recorded ranges, and integers to bytes.

Source:
    Paper, section 4.3 and Fig. 6.
"""

from __future__ import annotations

import math
import zlib
from typing import Any, TypeGuard

import numpy as np

from splatreel.base.errors import ReelError

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
