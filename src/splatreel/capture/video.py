"""Frames of one video file by number, decoded by PyAV (FFmpeg) at the output size."""

from __future__ import annotations

import io
import re
from bisect import bisect_right
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any, BinaryIO, cast

import av
import numpy as np
from av.container import InputContainer
from av.error import FFmpegError

from splatreel.base.errors import CaptureError
from splatreel.capture.color import VideoColor
from splatreel.capture.files import BRIEFLY, LOCAL, Files, main_video, open_media
from splatreel.capture.frame_table import NO_TIME, FrameTable, scan
from splatreel.capture.orientation import Orientation

SUFFIXES = (".mp4", ".m4v", ".mov")
"""Extensions of files whose tables fully describe the frames."""
PAYLOAD = b"mdat"


@dataclass(frozen=True)
class Box:
    """Box of an MP4 file: its kind, and the start and end of its content in the file."""

    kind: bytes
    start: int
    end: int


def top_level_boxes(file: BinaryIO, size: int) -> Iterator[Box]:
    """Yield the outermost boxes of an MP4 file of `size` bytes."""
    at = 0
    while at + 8 <= size:
        file.seek(at)
        head = file.read(16)
        length, kind, used = int.from_bytes(head[:4], "big"), head[4:8], 8
        if length == 1:
            length, used = int.from_bytes(head[8:16], "big"), 16
        end = size if length == 0 else min(at + length, size)
        if end < at + used:
            return
        yield Box(kind, at + used, end)
        at = end


class IndexOnly:
    """File object for PyAV that reads only the tables of an MP4 file and returns zeros for the image data.

    Demuxing it gives times and sizes of all frames. An hour of video has some megabytes of tables.
    """

    def __init__(self, file: BinaryIO) -> None:
        self.name = file.name
        self._file = file
        self._at = 0
        self._size = file.seek(0, io.SEEK_END)
        self._begins, self._ends = self._payload()

    def read(self, count: int) -> bytes:
        """Return bytes at the position, zeros for image data."""
        count = max(min(count, self._size - self._at), 0)
        place = bisect_right(self._begins, self._at) - 1
        if place >= 0 and self._at < self._ends[place]:
            data = bytes(min(count, self._ends[place] - self._at))
        else:
            after = self._begins[place + 1] if place + 1 < len(self._begins) else self._size
            self._file.seek(self._at)
            data = self._file.read(min(count, after - self._at))
        self._at += len(data)
        return data

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        """Set the position."""
        self._at = {io.SEEK_SET: 0, io.SEEK_CUR: self._at, io.SEEK_END: self._size}[whence] + offset
        return self._at

    def tell(self) -> int:
        """Return the position."""
        return self._at

    def close(self) -> None:
        """Close open files."""
        self._file.close()

    def _payload(self) -> tuple[list[int], list[int]]:
        """Return the start and end positions of image data in top-level boxes."""
        boxes = [box for box in top_level_boxes(self._file, self._size) if box.kind == PAYLOAD]
        return [box.start for box in boxes], [box.end for box in boxes]


VIDEO_SUFFIXES = (
    ".mp4",
    ".mov",
    ".m4v",
    ".mkv",
    ".webm",
    ".avi",
    ".mts",
    ".m2ts",
    ".ts",
    ".mxf",
    ".mpg",
    ".mpeg",
    ".3gp",
    ".wmv",
    ".flv",
)
"""Extensions of videos that are read."""
OTHER_VIDEOS = re.compile(
    r"\.(braw|r3d|crm|ari|arx|cine|insv|360|svo2?|bag|h26[45]|26[45]|hevc|y4m|yuv|ivf|obu|mjpe?g|vob|mod|tod|dv|ogv|f4v|asf|rmvb?|gif)",
    re.IGNORECASE,
)
"""Extensions of videos that are not read: raw formats of cameras, streams without times, and rare containers."""

WITHOUT_IMAGES = {"fflags": "noparse", "probesize": "32"}
"""FFmpeg options that do not parse images, which are zeros."""
STEPS_BACK = (0.5, 2.0, 10.0)
"""Seconds before a keyframe to seek to, if a seek to the keyframe itself overshot it."""
KEYFRAMES_BACK = (0, 1, 3, 7)
"""Numbers of keyframes to go back if a frame cannot be decoded from the previous one."""


class VideoFile:
    """Random access to the frames of one video, fast for sequential reads.

    The file is scanned once without decoding. Frames are identified by presentation time, so their numbers are exact,
    and variable frame rates do not shift cameras against each other. The first read opens the decoder, which stays
    open.

    Attributes:
        width: Display width in pixels.
        height: Display height in pixels.
        times: Times of the frames in seconds after the first one, [frames] float64.
        start: Time of the first frame in the file, seconds.

    Args:
        path: Video file.
        files: Access to the file.
        table: Frame table of an earlier scan, used if the file size matches.
        transfer: Transfer function for a video that declares none (`Sidecar.transfer`).
        partial: True reads the whole frames of a truncated file. Otherwise it is an error.
    """

    def __init__(
        self,
        path: Path,
        files: Files = LOCAL,
        table: FrameTable | None = None,
        transfer: str | None = None,
        partial: bool = False,
    ) -> None:
        self.path = path
        self._files = files
        self._container: InputContainer | None = None
        self._stream: Any = None
        self._decoder: Iterator[tuple[int, av.VideoFrame]] | None = None
        self._next = 0
        self._lock = Lock()
        self.table = table = self._scan() if table is None or table.size != self._size() else table
        self._orientation = Orientation(table.turns, table.mirrored)
        self.width, self.height = self._orientation.size(table.width, table.height)
        self.frames = table.frames
        self.fps = table.fps
        self.start = table.start
        self.times = table.times
        if table.whole < table.expected and not (partial and table.frames):
            advice = f"choose frames that are whole (--frames 0:{table.frames}), " if table.frames else ""
            raise CaptureError(f"{self.truncation}. Copy the file again, {advice}or leave the camera out.")
        self.color = VideoColor(*table.color).interpreted(path, transfer)

    @property
    def truncation(self) -> str:
        """Sentence about a truncated file, without its end; empty for a whole file."""
        if self.table.whole >= self.table.expected:
            return ""
        return f"{self.path}: is truncated: {self.table.whole} of {self.table.expected} frames are whole"

    def read_into(self, out: np.ndarray, numbers: np.ndarray) -> None:
        """Decode frames into an array.

        Args:
            out: Output, [count, H, W, 3] uint8 sRGB, to which frames are resized by area.
            numbers: Numbers of the frames, [count], ascending.
        """
        first, end = int(numbers[0]), int(numbers[-1]) + 1
        if not 0 <= first < end <= self.frames:
            raise CaptureError(f"{self.path}: frames {first}:{end} asked for, the video has {self.frames}.")
        missing = set(numbers.tolist())
        with self._lock, self._guard():
            for key in self._starts(first):
                self._read(out, numbers, missing, key)
                if not missing:
                    return
        self.close()
        raise CaptureError(
            f"{self.path}: frame {min(missing)} of {self.frames} cannot be decoded; the file is damaged. "
            f"Copy it again or choose frames before {min(missing)}."
        )

    def close(self) -> None:
        """Close the decoder. The next read opens it again."""
        if self._container is not None:
            self._container.close()
        self._container = self._decoder = None

    def _scan(self) -> FrameTable:
        with self._guard(), open_media(self._files, self.path) as container:
            stream = main_video(container)
            if stream is None:
                raise CaptureError(
                    f"{self.path}: holds no video stream. The file is not a video, or is truncated: "
                    f"copy it again or leave the camera out."
                )
            if self.path.suffix.lower() not in SUFFIXES:
                return scan(container, stream, self._size())
            tables = IndexOnly(self._files.raw(self.path))
            with closing(tables), av.open(cast(Any, tables), "r", options=WITHOUT_IMAGES) as index:
                return scan(container, stream, self._size(), cast(InputContainer, index))

    def _size(self) -> int:
        try:
            return self.path.stat().st_size
        except OSError as error:
            raise CaptureError(
                f"{self.path}: cannot be read ({error.strerror}). Put it back, or leave the camera out."
            ) from error

    def _starts(self, first: int) -> Iterator[int | None]:
        """Yield keyframes to start decoding at: after the last read (None), the keyframe before the frame, then earlier ones.

        One keyframe may not be enough: after the start of an intra refresh, images are complete only some frames later.
        """
        key = self.table.key_before(first)
        nearest = 0 if key < 0 else int(np.searchsorted(self.table.pts, self.table.key_pts[key]))
        if self._decoder is not None and self._next <= first and nearest <= self._next:
            yield None
        for step in KEYFRAMES_BACK:
            yield max(key - step, -1)
            if key < step:
                return

    def _read(self, out: np.ndarray, numbers: np.ndarray, missing: set[int], key: int | None) -> None:
        """Decode frames from a start of `_starts` on and remove them from `missing`."""
        if key is not None or self._decoder is None:
            self._next = 0
            self._decoder = self._decode_from(-1 if key is None else key)
        for number, frame in self._decoder:
            self._next = number + 1
            if number in missing and not frame.is_corrupt:
                check_size(self.path, number, frame, (self.table.width, self.table.height))
                out[numbers == number] = self.color.to_rgb(frame, out.shape[2], out.shape[1], self._orientation)
                missing.discard(number)
            if not missing or number > max(missing):
                return
        self._decoder = None  # end of the file

    def _decode_from(self, key: int) -> Iterator[tuple[int, av.VideoFrame]]:
        """Yield numbers and frames from a keyframe on. The generator is kept between reads, since decoders return batches."""
        begin = NO_TIME if key < 0 else int(self.table.key_pts[key])
        count = 0
        for packet in self._packets_from(key):
            for frame in self._decoded(packet, begin):
                if self.table.counted:
                    if count < self.frames:
                        yield count, frame
                    count += 1
                elif frame.pts is not None and frame.pts >= begin:  # earlier images refer to previous keyframes
                    number = self.table.number(frame.pts)
                    if number is not None:  # None is outside the edit list
                        yield number, frame

    def _decoded(self, packet: av.Packet, begin: int) -> list[av.VideoFrame]:
        """Decode a packet.

        A packet displayed before the keyframe may refer to missing images. The packet at which a file is truncated, and
        those that refer to it, are not in the table.
        """
        if packet.is_corrupt:
            return []
        try:
            return packet.decode()
        except FFmpegError:
            if packet.pts is not None and packet.pts < begin:
                return []
            raise

    def _packets_from(self, key: int) -> Iterator[av.Packet]:
        """Yield all packets from a keyframe on.

        MP4 and Matroska seek by presentation time, MPEG-TS by decoding time or bytes, and some containers only roughly.
        The keyframe is therefore searched from the result of a seek, and from farther back if it was passed.
        """
        wanted = None if key < 0 else int(self.table.key_pts[key])
        for packets in self._attempts(key):
            for packet in packets:
                if wanted is None or (packet.pts == wanted and packet.is_keyframe):
                    yield packet
                    yield from packets
                    return
                if packet.is_keyframe and packet.pts is not None and packet.pts > wanted:
                    break

    def _attempts(self, key: int) -> Iterator[Iterator[av.Packet]]:
        """Yield packet iterators from different positions; the last is the start of the file."""
        for offset, by_bytes in self._seeks(key):
            container, stream = self._opened()
            try:
                container.seek(offset, stream=stream, backward=True, unsupported_byte_offset=by_bytes)
            except FFmpegError:
                continue
            yield container.demux(stream)
        if self._container is not None:
            self._container.close()
            self._container = None
        container, stream = self._opened()
        yield container.demux(stream)

    def _seeks(self, key: int) -> Iterator[tuple[int, bool]]:
        """Yield positions to seek to, as time or byte offset and a flag for bytes, each less exact or farther back."""
        if key < 0:
            return
        table = self.table
        pts, dts, offset = int(table.key_pts[key]), int(table.key_dts[key]), int(table.key_offsets[key])
        dts = pts if dts == NO_TIME else dts
        if self._opened()[0].format.name == "mpegts":
            if offset != NO_TIME:
                yield offset, True
        else:
            yield pts, False
        yield dts, False
        for seconds in STEPS_BACK:
            yield min(pts, dts) - round(seconds / (table.time_base or 1.0)), False

    def _opened(self) -> tuple[InputContainer, av.VideoStream]:
        if self._container is None:
            self._container = open_media(self._files, self.path, BRIEFLY)  # the frame table has the rest
            self._stream = cast(av.VideoStream, main_video(self._container))
            self._stream.codec_context.thread_count = 1  # cameras are decoded in parallel instead
        return self._container, self._stream

    @contextmanager
    def _guard(self) -> Iterator[None]:
        """Convert FFmpeg's errors to `CaptureError`, and close the decoder, whose state is unknown after an error."""
        try:
            yield
        except (FFmpegError, OSError) as error:
            self.close()
            raise CaptureError(
                f"{self.path}: cannot be decoded ({error.strerror or error}). "
                f"The file is truncated or damaged: copy it again or leave the camera out."
            ) from error


def check_size(path: Path, number: int, frame: av.VideoFrame, size: tuple[int, int]) -> None:
    """Raise `CaptureError` for an image of another size than the first one's."""
    if (frame.width, frame.height) != size:
        raise CaptureError(
            f"{path}: frame {number} is {frame.width}x{frame.height}, frame 0 is {size[0]}x{size[1]}. Cut the video there, or "
            f"convert it to one size."
        )
