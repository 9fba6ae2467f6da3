"""One video file: its frames by number, decoded by PyAV (FFmpeg) straight to the output size."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np
from av.video.reformatter import Interpolation

from splatreel.errors import CaptureError


class VideoFile:
    """Random access to the frames of one video, cheap when read forwards.

    The file is scanned once without decoding, so that frames are known by their presentation times: their number is exact and
    variable frame rates cannot shift one camera against another. The decoder is opened by the first read and kept.
    width, height: pixels as stored. frames: how many there are. fps: average frames a second.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._container: av.container.InputContainer | None = None
        self._next = 0
        with self._guard(), av.open(str(path)) as container:
            if not container.streams.video:
                raise CaptureError(f"{path}: holds no video stream. Replace the file or leave the camera out.")
            stream = container.streams.video[0]
            self.width, self.height = stream.codec_context.width, stream.codec_context.height
            self.fps = float(stream.average_rate or stream.guessed_rate or 0)
            packets = [p for p in container.demux(stream) if p.size and p.pts is not None and not p.is_discard]
            declared = stream.frames
        self._pts = sorted(p.pts for p in packets if p.pts is not None)
        self._keys = sorted(p.pts for p in packets if p.is_keyframe and p.pts is not None)
        self.frames = len(self._pts)
        if self.frames < max(declared, 1) or any(p.is_corrupt for p in packets):
            raise CaptureError(
                f"{path}: is truncated: {self.frames} of {declared} frames are there. Copy the file again, "
                f"or cut every video to {self.frames} frames."
            )

    def read_into(self, out: np.ndarray, first: int) -> None:
        """Decode frames first .. first + len(out) - 1 into out [count, H, W, 3] uint8 sRGB, resized by area to H x W."""
        end = first + len(out)
        if not 0 <= first < end <= self.frames:
            raise CaptureError(f"{self.path}: frames {first}:{end} asked for, the video has {self.frames}.")
        with self._guard():
            missing = set(range(first, end))
            for number, frame in self._decode_from(first):
                if number in missing:
                    out[number - first] = _to_rgb(frame, out.shape[2], out.shape[1])
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
        if self._container is not None:
            self._container.close()
            self._container = None

    def _decode_from(self, first: int):
        """Yield (number, frame) from at most `first` on, going on where the last read ended if that is not further."""
        container = self._container
        if container is None:
            container = self._container = av.open(str(self.path))
            container.streams.video[0].codec_context.thread_count = 1  # cameras are decoded in parallel instead
            self._next = 0
        stream = container.streams.video[0]
        key = max((k for k in self._keys if k <= self._pts[first]), default=self._pts[0])
        if first < self._next or key > self._pts[min(self._next, self.frames - 1)]:
            container.seek(key, stream=stream, backward=True)
        numbers = {pts: i for i, pts in enumerate(self._pts)}
        for frame in container.decode(stream):
            number = numbers.get(frame.pts)
            if number is None:
                continue  # outside an edit list
            if frame.is_corrupt:
                raise CaptureError(f"{self.path}: frame {number} of {self.frames} is damaged. Copy the file again.")
            self._next = number + 1
            yield number, frame

    def _guard(self) -> _Guard:
        return _Guard(self)


class _Guard:
    """Turns FFmpeg's errors into ours and drops the decoder, whose state is unknown after one."""

    def __init__(self, video: VideoFile) -> None:
        self.video = video

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: type | None, error: BaseException | None, trace: object) -> None:
        if isinstance(error, av.FFmpegError):
            self.video.close()
            raise CaptureError(
                f"{self.video.path}: cannot be decoded ({error.strerror or error}). "
                f"The file is truncated or damaged: copy it again or leave the camera out."
            ) from error


def _to_rgb(frame: av.VideoFrame, width: int, height: int) -> np.ndarray:
    same = (frame.width, frame.height) == (width, height)
    interpolation = Interpolation.BICUBIC if same else Interpolation.AREA  # at the same size it only resamples chroma
    return frame.reformat(width, height, "rgb24", interpolation=interpolation).to_ndarray()
