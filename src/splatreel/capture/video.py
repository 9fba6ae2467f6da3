"""One video file: its frames by number, decoded by PyAV (FFmpeg) straight to the output size."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Lock

import av
import numpy as np
from av.container import InputContainer
from av.error import FFmpegError
from av.video.reformatter import Interpolation

from splatreel.errors import CaptureError

VIDEO_SUFFIXES = (".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi", ".mts", ".ts")
UPSAMPLE_CHROMA = Interpolation.BICUBIC | Interpolation.FULL_CHR_H_INT | Interpolation.ACCURATE_RND
"""FFmpeg interpolates 4:2:0 color only when told so; by default it repeats it, which costs 2 dB at saturated edges."""


class VideoFile:
    """Random access to the frames of one video, cheap when read forwards.

    The file is scanned once without decoding, so that frames are known by their presentation times: their number is exact and
    variable frame rates cannot shift one camera against another. The decoder is opened by the first read and kept.
    width, height: pixels as shown: phones store upright pictures lying. frames: how many there are. times: [frames] seconds after the
    first. start: seconds that the file says of the first. fps: average frames a second.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._container: InputContainer | None = None
        self._decoder: Iterator[av.VideoFrame] | None = None
        self._next = 0
        self._lock = Lock()
        if path.exists() and not path.is_file():  # a pipe is waited for
            raise CaptureError(f"{path}: is no file. Take it out of the capture.")
        with self._guard(), av.open(str(path)) as container:
            if not container.streams.video:
                raise CaptureError(
                    f"{path}: holds no video stream. The file is no video or truncated: "
                    f"copy it again or leave the camera out."
                )
            stream = container.streams.video[0]
            self.width, self.height = stream.codec_context.width, stream.codec_context.height
            time_base = float(stream.time_base or 0)
            self.fps = float(stream.average_rate or stream.guessed_rate or 0)
            declared = stream.frames
            packets = [
                (p.pts, p.is_keyframe, p.is_corrupt, p.is_discard)
                for p in container.demux(stream)
                if p.size and p.pts is not None
            ]
            self._turns = _quarter_turns(container, stream)
        if self._turns % 2:
            self.width, self.height = self.height, self.width
        self._pts = sorted(pts for pts, _, _, discard in packets if not discard)
        self._keys = sorted(pts for pts, key, _, discard in packets if key and not discard)
        self._numbers = {pts: number for number, pts in enumerate(self._pts)}
        self.frames = len(self._pts)
        self.start = (self._pts or [0])[0] * time_base
        self.times = (np.array(self._pts, np.float64) - (self._pts or [0])[0]) * time_base
        whole = sum(not corrupt for _, _, corrupt, _ in packets)
        if whole < max(declared, len(packets), 1):
            advice = f"or cut every video to {whole} frames" if whole else "or leave the camera out"
            raise CaptureError(
                f"{path}: is truncated: {whole} of {max(declared, len(packets))} frames are whole. Copy the file again, {advice}."
            )

    def read_into(self, out: np.ndarray, numbers: np.ndarray) -> None:
        """Decode the frames of these numbers, in rising order, into out [count, H, W, 3] uint8 sRGB, resized by area to H x W."""
        first, end = int(numbers[0]), int(numbers[-1]) + 1
        if not 0 <= first < end <= self.frames:
            raise CaptureError(f"{self.path}: frames {first}:{end} asked for, the video has {self.frames}.")
        with self._lock, self._guard():
            missing = set(numbers.tolist())
            for number, frame in self._decode_from(first):
                if number in missing:
                    out[numbers == number] = to_rgb(frame, out.shape[2], out.shape[1], self._turns)
                    missing.discard(number)
                if not missing:
                    break
        if missing:
            self.close()
            raise CaptureError(
                f"{self.path}: frame {min(missing)} of {self.frames} cannot be decoded; the file is damaged. "
                f"Copy it again or choose frames before {min(missing)}."
            )

    def close(self) -> None:
        """Drop the decoder; the next read opens a new one."""
        if self._container is not None:
            self._container.close()
        self._container = self._decoder = None

    def _decode_from(self, first: int) -> Iterator[tuple[int, av.VideoFrame]]:
        """Yield (number, frame) from at most `first` on, going on where the last read ended if nothing is nearer."""
        key = bisect_right(self._keys, self._pts[first]) - 1
        nearest = self._numbers[self._keys[key]] if key >= 0 else 0
        if self._decoder is None or first < self._next or nearest > self._next:
            self._decoder = self._decode_at(nearest)
        for frame in self._decoder:
            number = None if frame.pts is None else self._numbers.get(frame.pts)
            if number is None:
                continue  # outside an edit list
            if frame.is_corrupt:
                raise CaptureError(f"{self.path}: frame {number} of {self.frames} is damaged. Copy the file again.")
            self._next = number + 1
            yield number, frame

    def _decode_at(self, number: int) -> Iterator[av.VideoFrame]:
        """A new iterator over frames from a keyframe on. It is kept between reads, for the decoder hands out frames in batches."""
        if self._container is None:
            self._container = av.open(str(self.path))
            self._container.streams.video[0].codec_context.thread_count = 1  # cameras are decoded in parallel instead
        stream = self._container.streams.video[0]
        if number > 0 or self._next > 0:
            self._container.seek(self._pts[number], stream=stream, backward=True)
        self._next = number
        return self._container.decode(stream)

    @contextmanager
    def _guard(self) -> Iterator[None]:
        """Turns FFmpeg's errors into ours and drops the decoder, whose state is unknown after one."""
        try:
            yield
        except FFmpegError as error:
            self.close()
            raise CaptureError(
                f"{self.path}: cannot be decoded ({error.strerror or error}). "
                f"The file is truncated or damaged: copy it again or leave the camera out."
            ) from error


def _quarter_turns(container: InputContainer, stream: av.VideoStream) -> int:
    """Counterclockwise, by which pictures are turned to be shown. A file that cannot be decoded says so when it is read."""
    try:
        container.seek(0)
        frame = next(container.decode(stream), None)
    except FFmpegError:
        return 0
    return round(getattr(frame, "rotation", 0) / 90) % 4


def to_rgb(frame: av.VideoFrame, width: int, height: int, turns: int) -> np.ndarray:
    """uint8 [height, width, 3] sRGB of a decoded picture, resized by area and turned counterclockwise by quarters."""
    if turns % 2:
        width, height = height, width
    shrinks = width < frame.width or height < frame.height
    interpolation = Interpolation.AREA if shrinks else UPSAMPLE_CHROMA
    return np.rot90(frame.reformat(width, height, "rgb24", interpolation=interpolation).to_ndarray(), turns)
