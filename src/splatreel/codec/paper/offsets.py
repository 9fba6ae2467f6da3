"""The paper's codings of motion by name.

    h265        `ofs`: the offsets dx and dq h265-ori    `ori`: x + dx and q dq; the first frame also holds the
    canonical points h265-dif    `dif`: differences of offsets between consecutive frames; the first frame is relative
    to no motion float32     `raw`: the offsets uncompressed

For `ori` the paper adds quaternions. Rotations compose by multiplication (section 4.2), and the product is encoded
here.

Source:
    Paper, section 4.3 and Table 10.
"""

from __future__ import annotations

import numpy as np

from splatreel.base.errors import ReelError
from splatreel.codec.budget import check_offset_count, check_offsets
from splatreel.codec.paper import h265
from splatreel.codec.quantize import Parameters, decode_float32, encode_float32
from splatreel.config import H265Config
from splatreel.scene import rotations
from splatreel.scene.gaussians import Gaussians

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
    dq = about_identity(dq)
    if codec == "float32":
        data = encode_float32(dx)[0] + encode_float32(dq)[0]
        return data, {"codec": codec}
    if codec == ORIGINAL:
        quats = about_identity(rotations.multiply(rotations.normalize(points.quats.astype(np.float64)), dq[0]))
        turned = rotations.multiply(rotations.normalize(points.quats.astype(np.float64)), dq)
        dx, dq = points.means + dx, _continuous(turned, quats)
    elif codec == "h265-dif":
        dx = np.diff(dx.astype(np.float64), axis=0, prepend=0)
        dq = np.diff(dq, axis=0, prepend=np.broadcast_to(_REST, dq[:1].shape))
    data, parameters = h265.encode(dx, dq, config)
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
        dx, dq = h265.decode(data, parameters, frames, count)
    move, turn = np.zeros((count, 3)), np.tile(_REST, (count, 1))
    for frame in range(frames):
        if codec == "h265-dif":
            move, turn = move + dx[frame], turn + dq[frame]
            dx[frame], dq[frame] = move, turn
        dq[frame] = rotations.normalize(dq[frame])
    return dx, dq


def about_identity(dq: np.ndarray) -> np.ndarray:
    """Normalize rotations and choose the sign with w >= 0, which is near the identity (1, 0, 0, 0)."""
    dq = rotations.normalize(np.asarray(dq, np.float64))
    return np.where(dq[..., :1] < 0, -dq, dq)


def _continuous(quats: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Return quats [T, N, 4], each with the sign nearer to the frame before. `first` [N, 4] fixes the signs of the first frame."""
    before = np.concatenate([first[None], quats[:-1]])
    flips = np.sign((quats * before).sum(-1, keepdims=True))
    return quats * np.cumprod(np.where(flips < 0, -1.0, 1.0), axis=0)
