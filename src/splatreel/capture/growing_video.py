"""Video that is still being written: Matroska, MPEG-TS or fragmented MP4."""

from __future__ import annotations

from bisect import bisect_left, bisect_right, insort
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Event, Lock, Thread
from typing import BinaryIO

import av
import numpy as np
from av.container import InputContainer
from av.error import FFmpegError

from splatreel.base.errors import CaptureError
from splatreel.capture.capture_sound import GAP, RATE, Track, channels, choose
from splatreel.capture.color import VideoColor, declared_color
from splatreel.capture.files import LOCAL, main_video
from splatreel.capture.frame_table import frame_orientation
from splatreel.capture.growth import Growth
from splatreel.capture.orientation import STORED
from splatreel.capture.video import check_size

Packets = Iterator[tuple[float, av.Packet]]
"""Packets of one sound track, possibly from several files, each with the seconds by which its time exceeds the camera's."""


def read_packets(packets: Packets, count: int, start: float) -> Iterator[np.ndarray]:
    """Decode packets to blocks [n, count] float32 at `RATE`, starting `start` seconds after the camera's first frame.

    Gaps become silence, and repeated parts are dropped. Consecutive files share a decoder, because a new decoder has to
    settle.

    Args:
        packets: Packets of the track.
        count: Channels, 1 or 2.
        start: Seconds after the first frame.

    Raises:
        CaptureError: A packet cannot be decoded.
    """
    context: av.AudioCodecContext | None = None
    resampler = av.AudioResampler("flt", "mono" if count == 1 else "stereo", RATE)
    now: int | None = None  # samples yielded so far
    for shift, packet in packets:
        if packet.pts is not None and float(packet.pts * packet.time_base) - shift < start - 1:
            continue
        context = context or packet.stream.codec_context
        for frame in _decoded(context, packet):
            at = now or 0 if frame.time is None else round((frame.time - shift - start) * RATE)
            for part in _resampled(resampler, frame):
                block = part.reshape(-1, count)
                behind = (now or 0) - at
                if behind > (GAP * RATE if now else 0):
                    block, at = block[behind:], at + min(behind, len(block))
                elif -behind > (GAP * RATE if now else 0):
                    yield np.zeros((-behind, count), np.float32)
                    now = at
                if len(block):
                    yield block
                    now, at = (now or 0) + len(block), at + len(block)


def choose_growing_track(wanted: str, files: dict[str, Path], seconds: float, path: Path) -> tuple[str, int] | None:
    """Return the camera whose sound to use, and its number of channels; None without sound.

    Args:
        wanted: auto, none, or the name of a camera.
        files: File of each camera that is written so far.
        seconds: Duration to judge by. If all of it is silent, the first camera with a track is used.
        path: Folder of the capture, for messages.

    Raises:
        CaptureError: The wanted camera has no sound.
    """
    having = {name: count for name, file in files.items() if (count := channels(file))}
    if wanted == "none" or (wanted == "auto" and not having):
        return None
    if wanted == "auto":
        chosen = choose("auto", {name: Track(files[name], 0.0) for name in having}, seconds, 0.0, path)
        name = chosen.camera if chosen is not None and chosen.camera is not None else next(iter(having))
        return name, having[name]
    if wanted not in having:
        there = f"the cameras with sound are {', '.join(having)}" if having else "no camera has sound"
        raise CaptureError(
            f"{path}: --sound {wanted}: a capture that is followed has the sound of one of its cameras; {there}. Name one of them, "
            f"auto or none."
        )
    return wanted, having[wanted]


@contextmanager
def sound_errors(file: Path) -> Iterator[None]:
    """Convert FFmpeg's errors to `CaptureError`."""
    try:
        yield
    except (FFmpegError, OSError, ValueError) as error:
        raise CaptureError(
            f"{file}: its sound cannot be decoded ({getattr(error, 'strerror', None) or error})."
        ) from error


def _decoded(context: av.AudioCodecContext, packet: av.Packet) -> list[av.AudioFrame]:
    return context.decode(packet) if packet.size else []


def _resampled(resampler: av.AudioResampler, frame: av.AudioFrame) -> Iterator[np.ndarray]:
    frame.pts = None  # times may restart in each file
    for part in resampler.resample(frame):
        yield part.to_ndarray()


class Tail:
    """Growing file as a stream for FFmpeg. `read` waits for bytes that are not written yet, until the capture ends.

    Args:
        path: File to read.
        growth: State of the capture.
        left: Set when no reader is left.
    """

    def __init__(self, path: Path, growth: Growth, left: Event) -> None:
        self.name = str(path)
        self._path = path
        self._growth = growth
        self._left = left
        self._file: BinaryIO | None = None

    def read(self, count: int) -> bytes:
        """Return at least one byte, or none at the end. Raise OSError if the file cannot be read."""
        while True:
            if self._growth.stopped or self._left.is_set():
                return b""
            ended = self._growth.ended  # read before looking, so that everything written before the end is returned
            data = self._read_available(count)
            if data or ended:
                return data
            self._growth.pause()

    def close(self) -> None:
        """Close open files."""
        if self._file is not None:
            self._file.close()

    def _read_available(self, count: int) -> bytes:
        if self._file is None:
            try:
                self._file = LOCAL.raw(self._path)
            except FileNotFoundError:
                return b""
        return self._file.read(count)


OPTIONS = {"analyzeduration": "1000000", "fpsprobesize": "1"}
"""FFmpeg options that read no more than needed to detect the streams, because more is not written yet."""
COUNTED = 24
"""Number of frames whose times give the frame rate if the file does not state it."""
HELD_BACK = 16
"""Packets whose order may still change if the file has no decoding times. H.264 reorders no more than this."""
JUMP = 60.0
"""Seconds without a frame that are a jump of the recorder's clock, and not frames that a camera has lost."""


class GrowingVideo:
    """Complete frames of a growing video, indexed by presentation time.

    A thread demuxes packets as they are written. A frame counts once it and all frames displayed before it exist.
    Sequential reads are fast. Going back restarts at the beginning of the file and decodes from a keyframe. The
    constructor waits for the first frame.

    Raises:
        CaptureError: The file is not a video, or can only be read when complete.
    """

    def __init__(self, path: Path, growth: Growth, transfer: str | None = None) -> None:
        self.path = path
        self._growth = growth
        self._left = Event()
        self._pts: list[int] = []
        self._keys: list[int] = []
        self._final: int | None = -(1 << 63)  # no frame before this time is missing; None: all frames are known
        self._lock = Lock()
        self.failure: str | None = None
        self._latest: int | None = None  # decoding time of the last packet
        self._decoder: Iterator[tuple[av.VideoFrame, VideoColor]] | None = None
        self._next = 0
        with self._guard():
            _check_form(Tail(path, growth, self._left))
            container, stream = open_tail(Tail(path, growth, self._left))
        if stream is None:
            container.close()
            raise CaptureError(f"{path}: holds no video stream. Record it again or leave the camera out.")
        self._stored = stream.codec_context.width, stream.codec_context.height
        self._time_base = float(stream.time_base or 0)
        said = stream.average_rate
        self._thread = Thread(target=self._index, args=(container, stream), name=f"index {path.name}", daemon=True)
        self._thread.start()
        self._wait(1)
        self.fps = float(said) if said else self._counted_rate()
        self.color = VideoColor("yuv420p")
        self._orientation = STORED
        try:
            self._inspect(transfer)
        except CaptureError:
            self.close()
            raise
        self.width, self.height = self._orientation.size(*self._stored)

    def update(self) -> None:
        """Do nothing, because a thread checks for new frames."""

    def settle(self) -> None:
        """Wait until all frames are known, after the capture has ended."""
        self._thread.join()

    @property
    def waiting_for(self) -> Path:
        """File of the next frame."""
        return self.path

    @property
    def last(self) -> float | None:
        """Seconds from the first frame to the last complete one, or None."""
        whole = self._complete_frames()
        return self._seconds(self._pts[whole - 1]) if whole else None

    def numbers(self, wanted: np.ndarray) -> np.ndarray:
        """Return the number of the frame nearest to each time, in seconds after the first frame."""
        return np.array([self._nearest(float(time)) for time in wanted], np.int64)

    def frame_times(self, numbers: np.ndarray) -> np.ndarray:
        """Return the times of frames in seconds after the first frame."""
        return np.array([self._seconds(self._pts[number]) for number in numbers])

    def read_into(self, out: np.ndarray, numbers: np.ndarray) -> None:
        """Decode frames with ascending numbers into out [count, H, W, 3] uint8 sRGB, resized by area to H x W."""
        missing = set(numbers.tolist())
        with self._guard():
            for number, frame in self._decode_from(int(numbers[0])):
                if number in missing:
                    check_size(self.path, number, frame, self._stored)
                    out[numbers == number] = self.color.to_rgb(frame, out.shape[2], out.shape[1], self._orientation)
                    missing.discard(number)
                if not missing:
                    return
        self._drop_decoder()
        raise CaptureError(
            f"{self.path}: frame {min(missing)} cannot be decoded; the file is damaged. Follow from a later frame on (--frames)."
        )

    @property
    def written(self) -> Path:
        """File that can be read already."""
        return self.path

    def sound(self) -> Packets:
        """Yield the packets of the sound track as they are written."""
        with sound_errors(self.path), av.open(Tail(self.path, self._growth, self._left), "r") as container:
            shift = self._pts[0] * self._time_base
            for packet in container.demux(container.streams.audio[0]):
                yield shift, packet

    def close(self) -> None:
        """Stop reading permanently."""
        self._left.set()
        self._thread.join()
        self._drop_decoder()

    def _index(self, container: InputContainer, stream: av.VideoStream) -> None:
        try:
            with container:
                for packet in container.demux(stream):
                    if packet.size and packet.pts is not None and not packet.is_discard and not packet.is_corrupt:
                        self.failure = self._find_jump(packet.pts if packet.dts is None else packet.dts)
                        if self.failure is not None:
                            break  # later frames cannot be placed, so the camera ends here
                        self._note(packet.pts, packet.dts, packet.is_keyframe)
        except (FFmpegError, ValueError) as error:
            self.failure = f"cannot be read any further ({error})"
        with self._lock:
            self._final = None

    def _find_jump(self, time: int) -> str | None:
        """Describe a jump of the time of packets; None without one. Frames without decoding times may be out of order."""
        before, self._latest = self._latest, time
        if before is None or -1.0 < (time - before) * self._time_base < JUMP:
            return None
        begin, end = ((part - self._pts[0]) * self._time_base for part in (before, time))
        return f"its time jumps from {begin:.1f} s to {end:.1f} s after its first frame"

    def _note(self, pts: int, dts: int | None, key: bool) -> None:
        with self._lock:
            insort(self._pts, pts)
            if key:
                insort(self._keys, pts)
            if dts is not None:
                self._final = dts
            elif len(self._pts) > HELD_BACK:
                self._final = self._pts[-1 - HELD_BACK]

    def _counted_rate(self) -> float:
        """Return the frame rate measured on the first frames, after waiting for them."""
        self._wait(COUNTED)
        first = self._pts[: min(self._complete_frames(), COUNTED)]
        return (len(first) - 1) / self._seconds(first[-1]) if len(first) > 1 else 0.0

    def _wait(self, frames: int) -> None:
        while self._complete_frames() < frames and self._thread.is_alive():
            self._growth.pause()

    def _inspect(self, transfer: str | None) -> None:
        if (first := self._first_frame()) is not None:
            frame, color = first
            self._stored = (frame.width, frame.height)
            self._orientation = frame_orientation(frame, str(self.path))
            self.color = color.interpreted(self.path, transfer)

    def _first_frame(self) -> tuple[av.VideoFrame, VideoColor] | None:
        while not self._keys and self._thread.is_alive():
            self._growth.pause()
        try:
            return next(_frames(Tail(self.path, self._growth, self._left), self._keys[0])) if self._keys else None
        except (FFmpegError, OSError, StopIteration):
            return None

    def _complete_frames(self) -> int:
        with self._lock:
            return len(self._pts) if self._final is None else bisect_right(self._pts, self._final)

    def _seconds(self, pts: int) -> float:
        return (pts - self._pts[0]) * self._time_base

    def _nearest(self, time: float) -> int:
        with self._lock:
            after = bisect_left(self._pts, self._pts[0] + time / self._time_base)
            if after == len(self._pts):
                return after - 1
            sooner = after > 0 and time - self._seconds(self._pts[after - 1]) <= self._seconds(self._pts[after]) - time
            return after - 1 if sooner else after

    def _decode_from(self, first: int) -> Iterator[tuple[int, av.VideoFrame]]:
        """Yield numbers and frames from at most `first` on, continuing after the last read unless a keyframe is nearer."""
        with self._lock:
            key = self._keys[max(bisect_right(self._keys, self._pts[first]) - 1, 0)]
            nearest = bisect_left(self._pts, key)
        if self._decoder is None or first < self._next or nearest > self._next:
            self._drop_decoder()
            self._decoder = _frames(Tail(self.path, self._growth, self._left), key)
        for frame, _ in self._decoder:
            if frame.pts is None:
                continue
            with self._lock:
                number = bisect_left(self._pts, frame.pts)
            self._next = number + 1
            yield number, frame

    def _drop_decoder(self) -> None:
        self._decoder = None
        self._next = 0

    @contextmanager
    def _guard(self) -> Iterator[None]:
        try:
            yield
        except (FFmpegError, OSError) as error:
            self._drop_decoder()
            raise CaptureError(
                f"{self.path}: cannot be decoded ({error.strerror or error}). Record Matroska, MPEG-TS or fragmented MP4, or leave the "
                f"camera out."
            ) from error


def open_tail(tail: Tail) -> tuple[InputContainer, av.VideoStream | None]:
    """Open a growing file for one pass, and return its video stream. Waits until the streams are known."""
    container = av.open(tail, "r", options=OPTIONS)
    return container, main_video(container)


def _frames(tail: Tail, start: int) -> Iterator[tuple[av.VideoFrame, VideoColor]]:
    """Yield the frames, and their color, from the packet with presentation time `start` on.

    Earlier packets are read, but not decoded.
    """
    container, stream = open_tail(tail)
    with container:
        assert stream is not None
        stream.codec_context.thread_count = 1  # cameras are decoded in parallel instead
        begun = False
        for packet in container.demux(stream):
            begun = begun or packet.pts == start
            if begun:
                for frame in packet.decode():
                    yield frame, declared_color(stream.codec_context, frame)


def _check_form(tail: Tail) -> None:
    """Raise `CaptureError` for an MP4 file that is neither fragmented nor starts with its frame table."""
    if Path(tail.name).suffix.lower() not in (".mp4", ".m4v", ".mov"):
        return
    try:
        while len(head := _read(tail, 8)) == 8:
            size, kind = int.from_bytes(head[:4], "big"), head[4:]
            if kind == b"moov":
                return
            if kind == b"mdat" or size < 8:
                raise CaptureError(
                    f"{tail.name}: is an MP4 file that cannot be read before it is complete. Record Matroska (.mkv), MPEG-TS (.ts) or "
                    f"fragmented MP4, or numbered files of some seconds a camera."
                )
            _read(tail, size - 8)
    finally:
        tail.close()


def _read(tail: Tail, count: int) -> bytes:
    data = b""
    while len(data) < count and (part := tail.read(count - len(data))):
        data += part
    return data
