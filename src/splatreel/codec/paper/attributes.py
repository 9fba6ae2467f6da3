"""Sections with one row of values per point: quantized (paper section 4.3), float32, or as images (V3)."""

from __future__ import annotations

import numpy as np

from splatreel.codec import quantize
from splatreel.codec.paper import maps
from splatreel.codec.paper.hevc import decode_tracks, encode_tracks
from splatreel.codec.quantize import Parameters, boolean, numbers
from splatreel.errors import ReelError


def encode_values(
    values: np.ndarray, bits: int | None, *, log: bool = False, crf: int | None = None
) -> tuple[bytes, Parameters]:
    """Encode values [N, C].

    Args:
        values: One row per point.
        bits: Bits per value; None stores float32.
        log: Quantize logarithms of positive values.
        crf: Rate factor of H.265; None does not store the values as images.
    """
    if crf is not None:
        return _encode_pictures(values, log, crf)
    if bits is None:
        return quantize.encode_float32(values)
    return quantize.encode_linear(values, bits, log)


def decode_values(data: bytes, parameters: Parameters, rows: int, columns: int) -> np.ndarray:
    """Decode values [rows, columns] float32 with the section's codec. Raise `ReelError` if the section is damaged."""
    codec = parameters.get("codec")
    if codec == "linear":
        return quantize.decode_linear(data, parameters, rows, columns)
    if codec == "float32":
        return quantize.decode_float32(data, (rows, columns))
    if codec == "picture":
        return _decode_pictures(data, parameters, rows, columns)
    raise ReelError(f"has the unknown codec {codec!r:.60}; known are linear, float32 and picture.")


def _encode_pictures(values: np.ndarray, log: bool, crf: int) -> tuple[bytes, Parameters]:
    """Encode each column as an image of 8 bits, all in one HEVC track."""
    columns = np.asarray(values, np.float64)
    if log:
        columns = np.log2(np.maximum(columns, np.finfo(np.float32).tiny))
    low, high = columns.min(0), columns.max(0)
    q = np.rint((columns - low) / np.where(high > low, high - low, 1) * 255).astype(np.uint8)
    width, height = maps.size_of(len(q))
    pictures = maps.to_maps(q.T[:, :, None], maps.pixels_of(len(q), width), width, height)
    parameters: Parameters = {"codec": "picture", "width": width, "height": height}
    ranges = {"min": low.tolist(), "max": high.tolist()} | ({"log": True} if log else {})
    return encode_tracks([("values", pictures, f"crf={crf}")]), parameters | ranges


def _decode_pictures(data: bytes, parameters: Parameters, rows: int, columns: int) -> np.ndarray:
    width, height = maps.decode_size(parameters, rows)
    low, high = numbers(parameters, "min", columns), numbers(parameters, "max", columns)
    pictures = decode_tracks(data, 1, columns, [(width, height)])[0]
    q = maps.from_maps(pictures, maps.pixels_of(rows, width), width)[:, :, 0].T
    values = low + q * ((high - low) / 255)
    if boolean(parameters, "log", default=False):
        values = np.exp2(np.clip(values, -126, 126))
    return np.ascontiguousarray(values, np.float32)
