"""The paper's video codec of motion: positions of 16 bits and rotations of 8 bits as maps, encoded with HEVC.

The high byte of positions is lossless; the low byte and rotations are lossy. Beyond the paper, the low byte may be
folded: it is stored mirrored where the high byte is odd. Over positions it is then a triangle wave instead of a
sawtooth, whose jumps cost a video codec most. The module `offsets` chooses the values to encode.

Source:
    Paper, section 4.3.
"""

from __future__ import annotations

import numpy as np

from splatreel.base.errors import ReelError
from splatreel.codec.paper import maps
from splatreel.codec.paper.hevc import MAX_PIXELS, decode_tracks, encode_tracks
from splatreel.codec.quantize import Parameters, boolean, numbers
from splatreel.config import H265Config


def encode(dx: np.ndarray, dq: np.ndarray, config: H265Config) -> tuple[bytes, Parameters]:
    """Encode position values dx [T, N, 3] and quaternion values dq [T, N, 4] of N >= 1 points in Morton order."""
    count = dx.shape[1]
    if 4 * (2 * count + maps.MAX_SLACK) > 2 * MAX_PIXELS:
        raise ReelError(f"{count} dynamic points are more than the h265 codec holds. Lower the number of points.")
    width, height = maps.size_of(count)
    qx, dx_low, dx_high = _quantize(dx, 65535)
    qr, dq_low, dq_high = _quantize(dq, 255)
    high, low = (qx >> 8).astype(np.uint8), (qx & 255).astype(np.uint8)
    if config.fold:
        low = np.where(high & 1, 255 - low, low)
    pixels = maps.pixels_of(count, width)
    tracks = [
        ("hi", maps.to_maps(high, pixels, width, height), "lossless=1"),
        ("lo", maps.to_maps(low, pixels, width, height), f"crf={config.crf}"),
        ("rot", maps.to_maps(qr.astype(np.uint8), pixels, width, height), f"crf={config.crf}"),
    ]
    ranges = {"dx_min": dx_low, "dx_max": dx_high, "dq_min": dq_low, "dq_max": dq_high}
    parameters: Parameters = {"width": width, "height": height, "fold": config.fold}
    return encode_tracks(tracks), parameters | {name: value.tolist() for name, value in ranges.items()}


def decode(data: bytes, parameters: Parameters, frames: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Decode the values [T, N, 3] and [T, N, 4], float32. Raise `ReelError` if the section is damaged."""
    width, height = maps.decode_size(parameters, count)
    fold = boolean(parameters, "fold")
    ranges = [numbers(parameters, n, c) for n, c in (("dx_min", 3), ("dx_max", 3), ("dq_min", 4), ("dq_max", 4))]
    sizes = [(channels * width, height) for channels in (3, 3, 4)]
    tracks = decode_tracks(data, 3, frames, sizes)
    pixels = maps.pixels_of(count, width)
    dx, dq = np.empty((frames, count, 3), np.float32), np.empty((frames, count, 4), np.float32)
    for frame in range(frames):
        high, low, rot = (maps.from_maps(m[frame : frame + 1], pixels, width)[0] for m in tracks)
        if fold:
            low = np.where(high & 1, 255 - low, low)
        dx[frame] = _dequantize(high.astype(np.uint16) * 256 + low, ranges[0], ranges[1], 65535)
        dq[frame] = _dequantize(rot, ranges[2], ranges[3], 255)
    return dx, dq


def _quantize(values: np.ndarray, steps: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return integers 0..steps [T, N, C] uint16, minima [C] and maxima [C]."""
    low, high = (values.min((0, 1)).astype(np.float64), values.max((0, 1)).astype(np.float64))
    q = np.rint((values - low) / np.where(high > low, high - low, 1) * steps)
    return q.astype(np.uint16), low, high


def _dequantize(q: np.ndarray, low: np.ndarray, high: np.ndarray, steps: int) -> np.ndarray:
    return (low + q * ((high - low) / steps)).astype(np.float32)
