"""The paper's offset codec (section 4.3): offsets as maps, maps as HEVC.

dx gets 16 bits, its high byte lossless, its low byte lossy; dq gets 8 bits, lossy. Points come in Morton order, so
neighbours in a map are neighbours in space. Going past the paper, the low byte can be folded: stored mirrored where the high
byte is odd, it is a triangle wave over dx instead of a sawtooth, without the jumps that cost a video codec most.
"""

from __future__ import annotations

import numpy as np

from splatreel.codec.hevc import MAX_PIXELS, decode_tracks, encode_tracks
from splatreel.codec.quantize import Parameters, boolean, integer, numbers
from splatreel.config import EncodeConfig
from splatreel.errors import ReelError
from splatreel.scene import rotations

_BLOCK = 16
"""Side of the blocks the points run through, and what picture sides are multiples of."""
_MIN_SIDE = 64
"""One coding tree unit: x265 corrupts memory on pictures of 48 x 16 pixels."""
_MAX_SLACK = 4096
"""Pixels that a map may have beyond its points."""


def encode(dx: np.ndarray, dq: np.ndarray, config: EncodeConfig) -> tuple[bytes, Parameters]:
    """Encode dx [T, N, 3] and dq [T, N, 4], N >= 1, points in Morton order."""
    count = dx.shape[1]
    if 4 * (2 * count + _MAX_SLACK) > 2 * MAX_PIXELS:
        raise ReelError(f"{count} dynamic points are more than the h265 codec holds. Lower the number of points.")
    width = max(int(np.ceil(count**0.5 / _BLOCK)) * _BLOCK, _MIN_SIDE)
    height = max(int(np.ceil(count / (width * _BLOCK))) * _BLOCK, _MIN_SIDE)
    qx, dx_low, dx_high = _quantize(dx, 65535)
    qr, dq_low, dq_high = _quantize(_about_identity(dq), 255)
    high, low = (qx >> 8).astype(np.uint8), (qx & 255).astype(np.uint8)
    if config.fold:
        low = np.where(high & 1, 255 - low, low)
    pixels = _pixels(count, width)
    tracks = [
        ("hi", _to_maps(high, pixels, width, height), "lossless=1"),
        ("lo", _to_maps(low, pixels, width, height), f"crf={config.crf}"),
        ("rot", _to_maps(qr.astype(np.uint8), pixels, width, height), f"crf={config.crf}"),
    ]
    ranges = {"dx_min": dx_low, "dx_max": dx_high, "dq_min": dq_low, "dq_max": dq_high}
    parameters: Parameters = {"codec": "h265", "width": width, "height": height, "fold": config.fold}
    return encode_tracks(tracks), parameters | {name: value.tolist() for name, value in ranges.items()}


def decode(data: bytes, parameters: Parameters, frames: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """dx [T, N, 3] and unit dq [T, N, 4], float32. Raises `ReelError`."""
    width, height = (integer(parameters, side, _BLOCK, 8192) for side in ("width", "height"))
    if width % _BLOCK or height % _BLOCK or not count <= width * height <= 2 * count + _MAX_SLACK:
        raise ReelError(f"has maps of {width} x {height} pixels, which do not fit {count} points.")
    fold = boolean(parameters, "fold")
    ranges = [numbers(parameters, n, c) for n, c in (("dx_min", 3), ("dx_max", 3), ("dq_min", 4), ("dq_max", 4))]
    sizes = [(channels * width, height) for channels in (3, 3, 4)]
    maps = decode_tracks(data, 3, frames, sizes)
    pixels = _pixels(count, width)
    high, low, rot = (_from_maps(m, pixels, width) for m in maps)
    if fold:
        low = np.where(high & 1, 255 - low, low)
    dx = _dequantize(high.astype(np.uint16) * 256 + low, ranges[0], ranges[1], 65535)
    return dx, rotations.normalize(_dequantize(rot, ranges[2], ranges[3], 255))


def _about_identity(dq: np.ndarray) -> np.ndarray:
    """Unit rotations with w >= 0: q and -q turn alike, and this one is near the identity (1, 0, 0, 0)."""
    dq = rotations.normalize(np.asarray(dq, np.float64))
    return np.where(dq[..., :1] < 0, -dq, dq)


def _quantize(values: np.ndarray, steps: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(integers 0..steps [T, N, C] uint16, min [C], max [C])."""
    low, high = (values.min((0, 1)).astype(np.float64), values.max((0, 1)).astype(np.float64))
    q = np.rint((values - low) / np.where(high > low, high - low, 1) * steps)
    return q.astype(np.uint16), low, high


def _dequantize(q: np.ndarray, low: np.ndarray, high: np.ndarray, steps: int) -> np.ndarray:
    return (low + q * ((high - low) / steps)).astype(np.float32)


def _pixels(count: int, width: int) -> np.ndarray:
    """Index [count] into a map of that width, row by row, of each point: Z-order in blocks, blocks boustrophedon."""
    index = np.arange(count)
    block, inside = index >> 8, index & 255
    x, y = _even_bits(inside), _even_bits(inside >> 1)
    row, column = np.divmod(block, width // _BLOCK)
    column = np.where(row & 1, width // _BLOCK - 1 - column, column)
    return (row * _BLOCK + y) * width + column * _BLOCK + x


def _even_bits(value: np.ndarray) -> np.ndarray:
    return (value & 1) | (value >> 1 & 2) | (value >> 2 & 4) | (value >> 3 & 8)


def _to_maps(values: np.ndarray, pixels: np.ndarray, width: int, height: int) -> np.ndarray:
    """Pictures [T, height, C * width] uint8 of values [T, N, C]: one tile a channel, side by side."""
    frames, _, channels = values.shape
    maps = np.empty((frames, channels, height * width), np.uint8)
    maps[:] = values[:, -1, :, None]
    maps[:, :, pixels] = values.transpose(0, 2, 1)
    tiles = maps.reshape(frames, channels, height, width).transpose(0, 2, 1, 3)
    return np.ascontiguousarray(tiles.reshape(frames, height, channels * width))


def _from_maps(maps: np.ndarray, pixels: np.ndarray, width: int) -> np.ndarray:
    """Values [T, N, C] of pictures [T, height, C * width]."""
    frames, height, total = maps.shape
    tiles = maps.reshape(frames, height, total // width, width).transpose(0, 1, 3, 2)
    return np.ascontiguousarray(tiles).reshape(frames, height * width, -1)[:, pixels]
