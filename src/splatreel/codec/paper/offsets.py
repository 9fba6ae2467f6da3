"""The paper's codings of motion by name (section 4.3, Table 10): which values are coded, and how.

    h265        `ofs`: the offsets dx and dq themselves
    h265-ori    `ori`: x + dx and q dq; the canonical points are those of the first frame, and not stored once more
    h265-dif    `dif`: each frame's offsets less those of the frame before; those before the first are no motion at all
    float32     `raw`: the offsets uncompressed

The paper adds quaternions in `ori`; a point's rotation at a time is their product (section 4.2), which is what is coded here.
"""

from __future__ import annotations

import numpy as np

from splatreel.codec.budget import check_offset_count, check_offsets
from splatreel.codec.paper import h265
from splatreel.codec.quantize import Parameters, decode_float32, encode_float32
from splatreel.config import H265Config
from splatreel.errors import ReelError
from splatreel.scene import rotations
from splatreel.scene.gaussians import Gaussians

ORIGINAL = "h265-ori"
"""The codec whose first frame is the canonical points."""
NAMES = {"ofs": "h265", "ori": ORIGINAL, "dif": "h265-dif", "raw": "float32"}
"""`H265Config.source` to the codec of the section."""
_REST = np.array([1.0, 0, 0, 0])


def encode(dx: np.ndarray, dq: np.ndarray, points: Gaussians, config: H265Config) -> tuple[bytes, Parameters]:
    """Encode the motion dx [T, N, 3] and dq [T, N, 4] of N >= 1 points, in Morton order, as `config.source` says.

    Raises `ReelError` for NaN and for more offsets than one group may have.
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
    """dx [frames, count, 3] and unit dq [frames, count, 4], float32; of `h265-ori` positions and unit rotations instead.

    Raises `ReelError` if data is damaged.
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
    """Unit rotations with w >= 0: q and -q turn alike, and this one is near the identity (1, 0, 0, 0)."""
    dq = rotations.normalize(np.asarray(dq, np.float64))
    return np.where(dq[..., :1] < 0, -dq, dq)


def _continuous(quats: np.ndarray, first: np.ndarray) -> np.ndarray:
    """quats [T, N, 4], each with the sign that is nearer to the frame before; first [N, 4]: with the signs of the first frame."""
    before = np.concatenate([first[None], quats[:-1]])
    flips = np.sign((quats * before).sum(-1, keepdims=True))
    return quats * np.cumprod(np.where(flips < 0, -1.0, 1.0), axis=0)
