"""The paper's codings of motion by name.

- `h265`, source `ofs`: the offsets dx and dq.
- `h265-ori`, source `ori`: x + dx and q dq; the first frame also holds the canonical points.
- `h265-dif`, source `dif`: differences of offsets between consecutive frames; the first frame is relative to no motion.
- `float32`, source `raw`: the offsets uncompressed.

For `ori` the paper adds quaternions. Rotations compose by multiplication (section 4.2), and the product is encoded here.

Positions of 16 bits and rotations of 8 bits are maps, encoded with HEVC. The high byte of positions is lossless; the low byte and
rotations are lossy. Beyond the paper, the low byte may be folded: it is stored mirrored where the high byte is odd. Over positions
it is then a triangle wave instead of a sawtooth, whose jumps cost a video codec most.

Source:
    Paper, section 4.3 and Table 10.
"""

from __future__ import annotations

import numpy as np

from splatreel.base.errors import ReelError
from splatreel.codec.paper import hevc
from splatreel.codec.paper.hevc import MAX_PIXELS, decode_tracks, encode_tracks
from splatreel.codec.quantize import (
    Parameters,
    boolean,
    check_offset_count,
    check_offsets,
    decode_float32,
    encode_float32,
    numbers,
)
from splatreel.config import H265Config
from splatreel.scene import rotations
from splatreel.scene.gaussians import Gaussians


def _encode_video(dx: np.ndarray, dq: np.ndarray, config: H265Config) -> tuple[bytes, Parameters]:
    """Encode position values dx [T, N, 3] and quaternion values dq [T, N, 4] of N >= 1 points in Morton order."""
    count = dx.shape[1]
    if 4 * (2 * count + hevc.MAX_SLACK) > 2 * MAX_PIXELS:
        raise ReelError(f"{count} dynamic points are more than the h265 codec holds. Lower the number of points.")
    width, height = hevc.size_of(count)
    qx, dx_low, dx_high = _quantize(dx, 65535)
    qr, dq_low, dq_high = _quantize(dq, 255)
    high, low = (qx >> 8).astype(np.uint8), (qx & 255).astype(np.uint8)
    if config.fold:
        low = np.where(high & 1, 255 - low, low)
    pixels = hevc.pixels_of(count, width)
    tracks = [
        ("hi", hevc.to_maps(high, pixels, width, height), "lossless=1"),
        ("lo", hevc.to_maps(low, pixels, width, height), f"crf={config.crf}"),
        ("rot", hevc.to_maps(qr.astype(np.uint8), pixels, width, height), f"crf={config.crf}"),
    ]
    ranges = {"dx_min": dx_low, "dx_max": dx_high, "dq_min": dq_low, "dq_max": dq_high}
    parameters: Parameters = {"width": width, "height": height, "fold": config.fold}
    return encode_tracks(tracks), parameters | {name: value.tolist() for name, value in ranges.items()}


def _decode_video(data: bytes, parameters: Parameters, frames: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Decode the values [T, N, 3] and [T, N, 4], float32. Raise `ReelError` if the section is damaged."""
    width, height = hevc.decode_size(parameters, count)
    fold = boolean(parameters, "fold")
    ranges = [numbers(parameters, n, c) for n, c in (("dx_min", 3), ("dx_max", 3), ("dq_min", 4), ("dq_max", 4))]
    sizes = [(channels * width, height) for channels in (3, 3, 4)]
    tracks = decode_tracks(data, 3, frames, sizes)
    pixels = hevc.pixels_of(count, width)
    dx, dq = np.empty((frames, count, 3), np.float32), np.empty((frames, count, 4), np.float32)
    for frame in range(frames):
        high, low, rot = (hevc.from_maps(m[frame : frame + 1], pixels, width)[0] for m in tracks)
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


ORIGINAL = "h265-ori"
"""Codec whose first frame holds the canonical points."""
NAMES = {"ofs": "h265", "ori": ORIGINAL, "dif": "h265-dif", "raw": "float32"}
"""Codec of the section by `H265Config.source`."""
_REST = np.array([1.0, 0, 0, 0])


def encode(dx: np.ndarray, dq: np.ndarray, points: Gaussians, config: H265Config) -> tuple[bytes, Parameters]:
    """Encode the motion of N >= 1 points in Morton order, as `config.source` selects.

    Args:
        dx: Position offsets, [T, N, 3].
        dq: Rotation offsets, [T, N, 4].
        points: Canonical points.
        config: Settings of the codec.

    Raises:
        ReelError: An offset is NaN or infinite, or a group has too many offsets.
    """
    check_offsets(dx, dq)
    codec = NAMES[config.source]
    dq = _about_identity(dq)
    if codec == "float32":
        data = encode_float32(dx)[0] + encode_float32(dq)[0]
        return data, {"codec": codec}
    if codec == ORIGINAL:
        quats = _about_identity(rotations.multiply(rotations.normalize(points.quats.astype(np.float64)), dq[0]))
        turned = rotations.multiply(rotations.normalize(points.quats.astype(np.float64)), dq)
        dx, dq = points.means + dx, _continuous(turned, quats)
    elif codec == "h265-dif":
        dx = np.diff(dx.astype(np.float64), axis=0, prepend=0)
        dq = np.diff(dq, axis=0, prepend=np.broadcast_to(_REST, dq[:1].shape))
    data, parameters = _encode_video(dx, dq, config)
    return data, {"codec": codec} | parameters


def decode(data: bytes, parameters: Parameters, frames: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Decode dx [frames, count, 3] and unit dq [frames, count, 4], float32. `h265-ori` gives positions and unit rotations instead.

    Raises:
        ReelError: The data is damaged.
    """
    check_offset_count(frames, count)
    codec = parameters.get("codec")
    if codec not in NAMES.values():
        raise ReelError(f"has the unknown offset codec {codec!r:.60}; known are {', '.join(sorted(NAMES.values()))}.")
    if codec == "float32":
        size = 12 * frames * count
        dx = decode_float32(data[:size], (frames, count, 3))
        dq = decode_float32(data[size:], (frames, count, 4))
    else:
        dx, dq = _decode_video(data, parameters, frames, count)
    move, turn = np.zeros((count, 3)), np.tile(_REST, (count, 1))
    for frame in range(frames):
        if codec == "h265-dif":
            move, turn = move + dx[frame], turn + dq[frame]
            dx[frame], dq[frame] = move, turn
        dq[frame] = rotations.normalize(dq[frame])
    return dx, dq


def _about_identity(dq: np.ndarray) -> np.ndarray:
    """Normalize rotations and choose the sign with w >= 0, which is near the identity (1, 0, 0, 0)."""
    dq = rotations.normalize(np.asarray(dq, np.float64))
    return np.where(dq[..., :1] < 0, -dq, dq)


def _continuous(quats: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Return quats [T, N, 4], each with the sign nearer to the frame before. `first` [N, 4] fixes the signs of the first frame."""
    before = np.concatenate([first[None], quats[:-1]])
    flips = np.sign((quats * before).sum(-1, keepdims=True))
    return quats * np.cumprod(np.where(flips < 0, -1.0, 1.0), axis=0)
