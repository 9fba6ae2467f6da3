"""One video that is still being written: Matroska, MPEG-TS or fragmented MP4."""

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

from splatreel.capture.growing.growing_sound import Packets, guard
from splatreel.capture.growing.growth import Growth
from splatreel.capture.video import to_rgb
from splatreel.errors import CaptureError


class Tail:
    """A file as FFmpeg reads a stream, from its start on. `read` waits for bytes that are not written yet, until it has ended.

    left: set when nobody reads it any more.
    """

    def __init__(self, path: Path, growth: Growth, left: Event) -> None:
        self.name = str(path)
        self._path, self._growth, self._left = path, growth, left
        self._file: BinaryIO | None = None

    def read(self, count: int) -> bytes:
        """At least one byte; none at the end. Raises OSError where the file cannot be read."""
        while True:
            if self._growth.stopped or self._left.is_set():
                return b""
            ended = self._growth.ended  # asked first: what was written before the end is still read
            data = self._there(count)
            if data or ended:
                return data
            self._growth.pause()

    def close(self) -> None:
        if self._file is not None:
            self._file.close()

    def _there(self, count: int) -> bytes:
        if self._file is None:
            try:
                self._file = open(self._path, "rb", buffering=0)  # noqa: SIM115 - `close` closes it
            except FileNotFoundError:
                return b""
        return self._file.read(count)


OPTIONS = {"analyzeduration": "1000000", "fpsprobesize": "1"}
"""FFmpeg looks at no more of the file than it needs to say what is in it: more is not there yet."""
COUNTED = 24
"""Frames by whose times the rate is known where the file does not say it."""
HELD_BACK = 16
"""Packets whose order is not known to be final where a file does not say when they are decoded: H.264 reorders no more."""


class GrowingVideo:
    """The frames of a video as far as they are whole, known by their presentation times.

    A thread reads the packets as they are written, without decoding. A frame counts once it is there with all that is shown before
    it. Reading forwards is cheap; going back begins at the start of the file again, and decodes from the keyframe on.
    width, height: pixels. fps: average frames a second. Waits until the first one is whole.
    Raises `CaptureError` for what can only be read once it is complete, and for what is no video.
    """

    def __init__(self, path: Path, growth: Growth) -> None:
        self.path, self._growth, self._left = path, growth, Event()
        self._pts: list[int] = []
        self._keys: list[int] = []
        self._final: int | None = -(1 << 63)  # the time up to which no more frames can come; None: all are known
        self._lock, self._failure = Lock(), None
        self._decoder: Iterator[av.VideoFrame] | None = None
        self._next = 0
        with self._guard():
            _check_form(Tail(path, growth, self._left))
            container, stream = open_tail(Tail(path, growth, self._left))
        if stream is None:
            container.close()
            raise CaptureError(f"{path}: holds no video stream. Record it again or leave the camera out.")
        self.width, self.height = stream.codec_context.width, stream.codec_context.height
        self._time_base = float(stream.time_base or 0)
        said = stream.average_rate
        self._thread = Thread(target=self._index, args=(container, stream), name=f"index {path.name}", daemon=True)
        self._thread.start()
        self._wait(1)
        self.fps = float(said) if said else self._counted_rate()

    def update(self) -> None:
        """Nothing to do: a thread does it."""

    def settle(self) -> None:
        """Once the capture has ended: wait until all that is there is known."""
        self._thread.join()

    @property
    def waiting_for(self) -> Path:
        """The file in which the next frame will be."""
        return self.path

    @property
    def last(self) -> float | None:
        """Seconds from the first frame to the last one that is whole; None where none is."""
        whole = self._whole()
        return self._seconds(self._pts[whole - 1]) if whole else None

    def numbers(self, wanted: np.ndarray) -> np.ndarray:
        """Of each time, in seconds after the first frame, the number of the frame nearest to it."""
        return np.array([self._nearest(float(time)) for time in wanted], np.int64)

    def read_into(self, out: np.ndarray, numbers: np.ndarray) -> None:
        """Decode the frames of these numbers, in rising order, into out [count, H, W, 3] uint8 sRGB, resized by area to H x W."""
        missing = set(numbers.tolist())
        with self._guard():
            for number, frame in self._decode_from(int(numbers[0])):
                if number in missing:
                    out[numbers == number] = to_rgb(frame, out.shape[2], out.shape[1], 0)
                    missing.discard(number)
                if not missing:
                    return
        self._drop_decoder()
        raise CaptureError(
            f"{self.path}: frame {min(missing)} cannot be decoded; the file is damaged. Follow from a later frame on (--frames)."
        )

    @property
    def written(self) -> Path:
        """A file that can be read by now, to see what it holds."""
        return self.path

    def sound(self) -> Packets:
        """The packets of its sound track, as they are written."""
        with guard(self.path), av.open(Tail(self.path, self._growth, self._left), "r") as container:
            shift = self._pts[0] * self._time_base
            for packet in container.demux(container.streams.audio[0]):
                yield shift, packet

    def close(self) -> None:
        """Stop reading, for good."""
        self._left.set()
        self._thread.join()
        self._drop_decoder()

    def _index(self, container: InputContainer, stream: av.VideoStream) -> None:
        try:
            with container:
                for packet in container.demux(stream):
                    if packet.size and packet.pts is not None and not packet.is_discard and not packet.is_corrupt:
                        self._note(packet.pts, packet.dts, packet.is_keyframe)
        except (FFmpegError, ValueError) as error:
            self._failure = error  # what comes after cannot be read; the camera stops here
        with self._lock:
            self._final = None

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
        """Frames a second, by the first ones; waits for them."""
        self._wait(COUNTED)
        first = self._pts[: min(self._whole(), COUNTED)]
        return (len(first) - 1) / self._seconds(first[-1]) if len(first) > 1 else 0.0

    def _wait(self, frames: int) -> None:
        """Until so many are whole, or no more come."""
        while self._whole() < frames and self._thread.is_alive():
            self._growth.pause()

    def _whole(self) -> int:
        """How many frames are whole, from the first on."""
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
        """(number, frame) from at most `first` on, going on where the last read ended if no keyframe is nearer."""
        with self._lock:
            key = self._keys[max(bisect_right(self._keys, self._pts[first]) - 1, 0)]
            nearest = bisect_left(self._pts, key)
        if self._decoder is None or first < self._next or nearest > self._next:
            self._drop_decoder()
            self._decoder = _frames(Tail(self.path, self._growth, self._left), key)
        for frame in self._decoder:
            if frame.pts is None:
                continue
            with self._lock:
                number = bisect_left(self._pts, frame.pts)
            self._next = number + 1
            yield number, frame

    def _drop_decoder(self) -> None:
        self._decoder, self._next = None, 0

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
    """A file that is being written, to be read once from its start on, and its video; waits until it says what is in it."""
    container = av.open(tail, "r", options=OPTIONS)
    return container, container.streams.video[0] if container.streams.video else None


def _frames(tail: Tail, start: int) -> Iterator[av.VideoFrame]:
    """The frames from the packet of presentation time `start` on; what comes before is read, but not decoded."""
    container, stream = open_tail(tail)
    with container:
        assert stream is not None
        stream.codec_context.thread_count = 1  # cameras are decoded in parallel instead
        begun = False
        for packet in container.demux(stream):
            begun = begun or packet.pts == start
            if begun:
                yield from packet.decode()


def _check_form(tail: Tail) -> None:
    """An MP4 is either in fragments, or has its table of frames before them; else it cannot be read before it is complete."""
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
