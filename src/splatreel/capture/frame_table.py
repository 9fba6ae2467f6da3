"""Frame table of a video file: presentation times, keyframes and their byte offsets, found without decoding."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import astuple, dataclass, fields
from pathlib import Path
from typing import Any, cast

import av
import numpy as np
from av.container import InputContainer
from av.error import FFmpegError
from av.sidedata.sidedata import Type
from safetensors import SafetensorError
from safetensors.numpy import load_file, save

from splatreel.base.errors import CaptureError
from splatreel.base.untrusted import check_regular, parse_json
from splatreel.capture.color import declared_color
from splatreel.capture.orientation import STORED, Orientation, display_orientation

WITHOUT_TIMES = ("avi", "mxf")
"""FFmpeg's names of containers that may lack presentation times although the codec reorders frames."""
NO_TIME = np.iinfo(np.int64).min
"""Value of a decoding time or byte offset that the container does not state."""
FILMED_RATE = "com.android.capture.fps"
"""Tag with the rate at which a phone filmed slow motion."""
ARRAYS = ("pts", "key_pts", "key_dts", "key_offsets")
"""Fields of a table that are arrays."""


@dataclass(frozen=True)
class FrameTable:
    """Index that allows reading any frame of a video without scanning the file.

    Attributes:
        size: Size of the file in bytes. A table with another size belongs to another file.
        width: Width of a stored image in pixels. Phones store upright videos sideways.
        turns: Counterclockwise quarter turns for display.
        mirrored: True flips stored images left to right before these turns.
        time_base: Seconds per unit of `pts` and `dts`.
        pts: Presentation times of displayed frames that are complete, [N] int64, ascending.
        key_pts: Presentation times of keyframes, [K] int64, ascending, including those hidden by an edit list.
        key_dts: Their decoding times, [K] int64, or `NO_TIME`.
        key_offsets: Their byte offsets, [K] int64, or `NO_TIME`.
        counted: True if the container has no presentation times although the codec reorders frames (H.264 in AVI and MXF). Such
            frames are numbered by counting the decoder's output from the start of the file.
        packets: Number of packets in the file.
        whole: Number of complete packets.
        declared: Number of frames that the container states, or 0.
        filmed: Frames per second at which the camera states to have filmed, or 0.
        sound_seconds: Duration of the sound that the container states, or 0.
    """

    size: int
    width: int
    height: int
    turns: int
    mirrored: bool
    color: tuple[str, int, int, int, bool]
    fps: float
    time_base: float
    pts: np.ndarray
    key_pts: np.ndarray
    key_dts: np.ndarray
    key_offsets: np.ndarray
    counted: bool
    packets: int
    whole: int
    declared: int
    filmed: float = 0.0
    sound_seconds: float = 0.0

    @property
    def expected(self) -> int:
        """Number of packets that the whole file would have."""
        return max(self.declared, self.packets, 1)

    @property
    def frames(self) -> int:
        """Number of displayed frames."""
        return len(self.pts)

    @property
    def start(self) -> float:
        """Time of the first frame in the file, seconds."""
        return float(self.pts[0]) * self.time_base if len(self.pts) else 0.0

    @property
    def times(self) -> np.ndarray:
        """Times of the frames in seconds after the first one, [N] float64."""
        return (self.pts - (self.pts[0] if len(self.pts) else 0)).astype(np.float64) * self.time_base

    def number(self, pts: int) -> int | None:
        """Return the number of the frame with a presentation time, or None if no displayed frame has it."""
        at = int(np.searchsorted(self.pts, pts))
        return at if at < len(self.pts) and self.pts[at] == pts else None

    def key_before(self, number: int) -> int:
        """Return the index of the last keyframe displayed no later than a frame; -1 means decoding from the start of the file."""
        return -1 if self.counted else int(np.searchsorted(self.key_pts, self.pts[number], "right")) - 1


def scan(
    container: InputContainer, stream: av.VideoStream, size: int, index: InputContainer | None = None
) -> FrameTable:
    """Demux a whole container and return its frame table.

    Args:
        container: Open container at its start. It is consumed.
        stream: Its video stream.
        size: Size of the file in bytes.
        index: The same container without image data (`IndexOnly`), used wherever no image is needed.

    Raises:
        CaptureError: The orientation is not a quarter turn.
    """
    fps = float(stream.average_rate or stream.guessed_rate or 0)
    demuxed, packets_of = container, stream
    if index is not None:
        demuxed, packets_of = index, next(found for found in index.streams.video if found.index == stream.index)
    declared = _declared(demuxed, packets_of)
    rows, packets, whole = [], 0, 0
    for packet in demuxed.demux(packets_of):
        if packet.size and packet.pts is not None:
            packets += 1
            whole += not packet.is_corrupt
            dts = NO_TIME if packet.dts is None else packet.dts
            offset = NO_TIME if packet.pos is None or packet.pos < 0 else packet.pos
            if not packet.is_corrupt:
                rows.append((packet.pts, dts, offset, packet.is_keyframe, packet.is_discard))
    pts, dts, offsets, key, hidden = np.array(rows, np.int64).reshape(-1, 5).T
    first = _first_frame(container, stream)
    reorders = first is not None and bool(stream.codec_context.has_b_frames)
    orientation = STORED if first is None else frame_orientation(first, container.name)
    color = declared_color(stream.codec_context, first)
    counted = container.format.name in WITHOUT_TIMES and reorders and bool((np.diff(pts) > 0).all())
    keys = np.flatnonzero(key)[np.argsort(pts[key != 0], kind="stable")]
    shown = np.unique(pts[(hidden == 0) & _decodable(pts, key)])
    return FrameTable(
        size=size,
        width=(first or stream.codec_context).width,
        height=(first or stream.codec_context).height,
        turns=orientation.turns,
        mirrored=orientation.mirrored,
        color=astuple(color),
        fps=fps,
        time_base=float(stream.time_base or 0),
        pts=shown,
        key_pts=pts[keys],
        key_dts=dts[keys],
        key_offsets=offsets[keys],
        counted=counted,
        packets=packets,
        whole=whole,
        declared=declared,
        filmed=_filmed_rate(container, stream),
        sound_seconds=_sound_seconds(container),
    )


def _filmed_rate(container: InputContainer, stream: av.VideoStream) -> float:
    """Return the frames per second at which a phone states to have filmed; 0 without such a statement."""
    text = container.metadata.get(FILMED_RATE) or stream.metadata.get(FILMED_RATE) or ""
    try:
        rate = float(text)
    except ValueError:
        return 0.0
    return rate if 1 <= rate <= 1e5 else 0.0


def _sound_seconds(container: InputContainer) -> float:
    for stream in container.streams.audio[:1]:
        if stream.duration and stream.time_base:
            return float(stream.duration * stream.time_base)
    return 0.0


def pack_tables(tables: dict[str, FrameTable]) -> bytes:
    """Return the content of a file with tables by name."""
    arrays, rest = {}, {}
    for number, (name, table) in enumerate(tables.items()):
        values = {field.name: getattr(table, field.name) for field in fields(table)}
        arrays |= {f"{number}.{key}": values.pop(key) for key in ARRAYS}
        rest[name] = values
    arrays["rest"] = np.frombuffer(json.dumps(rest).encode(), np.uint8)
    return save(arrays)


def load_tables(path: Path) -> dict[str, FrameTable]:
    """Return the tables in a file by name, or none if the file is missing or unreadable. Videos are then scanned."""
    try:
        check_regular(path, CaptureError)
        arrays = load_file(str(path))
        rest = parse_json(arrays["rest"].tobytes(), CaptureError, f"{path}:")
        found: dict[str, FrameTable] = {}
        for number, (name, values) in enumerate(rest.items()):
            everything: dict[str, Any] = values | {key: arrays[f"{number}.{key}"] for key in ARRAYS}
            everything["color"] = tuple(values["color"])
            found[name] = FrameTable(**everything)
        return found
    except (OSError, SafetensorError, CaptureError, ValueError, KeyError, TypeError, AttributeError):
        return {}


def _declared(container: InputContainer, stream: av.VideoStream) -> int:
    """Return the number of packets that the container states, or 0. MP4 files also count frames that an edit list hides."""
    entries = getattr(stream, "index_entries", None)
    if entries is None or "mp4" not in container.format.name or not stream.frames:
        return stream.frames
    return min(len(entries), stream.frames)


def _decodable(pts: np.ndarray, key: np.ndarray) -> np.ndarray:
    """Return the packets, in decoding order, that are not cut off from their keyframe, [N] bool.

    Frames before the first keyframe refer to images that the file does not contain, for example after a cut.
    """
    first = int(np.argmax(key)) if key.any() else 0
    if first == 0:
        return np.ones(len(pts), bool)
    return (np.arange(len(pts)) >= first) & (pts >= pts[first])


def frame_orientation(frame: av.VideoFrame, name: str) -> Orientation:
    """Return the orientation that a file declares for a decoded image. Raise `CaptureError` if it is not a quarter turn."""
    data: Any = cast(Any, frame.side_data).get(Type.DISPLAYMATRIX)
    orientation = STORED if data is None else display_orientation(bytes(data))
    if orientation is None:
        raise CaptureError(f"{name}: is shown at an angle of {frame.rotation} degrees. Convert it to an upright video.")
    return orientation


def _first_frame(container: InputContainer, stream: av.VideoStream) -> av.VideoFrame | None:
    """Decode the first image. Decoding errors are reported on reading."""
    try:
        container.seek(0)
        return next(_frames(container, stream), None)
    except FFmpegError:
        return None


def _frames(container: InputContainer, stream: av.VideoStream) -> Iterator[av.VideoFrame]:
    yield from container.decode(stream)
