"""Sound of a capture's videos: reading it, and choosing the best track."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path

import av
import numpy as np
from av.error import FFmpegError

from splatreel.base import threads
from splatreel.base.errors import CaptureError
from splatreel.capture.files import LOCAL, Files, main_video, open_media

RATE = 48_000
"""Samples per second."""
LOUD = 0.99
"""Samples of at least this amplitude count as clipped."""
CLIPPED = 1e-4
"""Share of clipped samples, about five per second, up to which a track counts as undistorted."""
AS_LOUD = 0.7
"""Share of the largest root mean square above which the first track is used, so that other frames do not change the choice."""
SILENT = 1e-5
"""Root mean square below which a track is silent, 100 dB below full scale."""
WINDOWS, WINDOW = 12, 5.0
"""Number and duration in seconds of the parts by which a long track is judged."""
PREROLL = 2.0
"""Seconds decoded before the wanted part, so that the decoder settles."""
GAP = 0.02
"""Tolerance in seconds of a file's times. Larger gaps are filled with silence."""


@dataclass(frozen=True)
class Track:
    """Location of the sound of some frames.

    Attributes:
        file: File that shows whether there is sound.
        start: Seconds after its first frame at which the sound starts.
        files: Access to the file.
        blocks: Function from a number of channels to blocks [n, channels] from `start` on, for sound in several files.
        speed: Seconds of the file in a second of the capture, for a clock that drifts. Sound in several files is not
            resampled.
    """

    file: Path
    start: float
    files: Files = LOCAL
    blocks: Callable[[int], Iterator[np.ndarray]] | None = None
    speed: float = 1.0

    def read(self, channels: int, skip: float = 0.0) -> Iterator[np.ndarray]:
        """Yield blocks [n, channels] float32 at `RATE` from `skip` seconds after `start` on."""
        if self.blocks is None:
            start = self.start + skip * self.speed
            return read_sound(self.file, channels, round(RATE / self.speed), start, self.files)
        return _without_first(self.blocks(channels), round(skip * RATE))


@dataclass(frozen=True)
class Choice:
    """Chosen track.

    Attributes:
        channels: 1 or 2.
        camera: Name of the camera; None for a separate file.
        why: Reason for users, shown after the name.
    """

    track: Track
    channels: int
    camera: str | None
    why: str = ""

    def __str__(self) -> str:
        name = f"camera {self.camera}" if self.camera is not None else str(self.track.file)
        return f"{name} ({self.why})" if self.why else name

    def samples(self, seconds: float, skip: float = 0.0) -> Iterator[np.ndarray]:
        """Yield blocks [n, channels] float32 at `RATE` for a duration, padded with silence.

        Args:
            seconds: Duration.
            skip: Seconds to skip at the start.
        """
        yield from _cut(self.track.read(self.channels, skip), seconds, self.channels)


@dataclass(frozen=True)
class Loudness:
    """Loudness of a track: root mean square of the samples, and share of clipped samples."""

    rms: float
    clipped: float


def choose(wanted: str, tracks: dict[str, Track], seconds: float, begin: float, path: Path) -> Choice | None:
    """Return the sound for a reel, or None without sound.

    Args:
        wanted: auto, none, the name of a camera, or a file.
        tracks: Tracks of cameras with videos.
        seconds: Duration of the reel.
        begin: Seconds from the start of the capture to the reel's first frame, at which a file starts.
        path: Folder of the capture, for messages.

    Raises:
        CaptureError: The wanted camera or file has no sound in these frames, or cannot be read.
    """
    if wanted == "none":
        return None
    if wanted == "auto":
        return _best(tracks, seconds)
    if wanted in tracks:
        choice = Choice(tracks[wanted], channels(tracks[wanted].file, tracks[wanted].files), wanted)
    elif Path(wanted).is_file():
        choice = Choice(Track(Path(wanted), begin), channels(Path(wanted)), None)
    else:
        having = f"the cameras with videos are {', '.join(tracks)}" if tracks else "no camera of it has a video"
        raise CaptureError(
            f"{path}: --sound {wanted}: is neither a file nor such a camera; {having}. Name one of them or a file, or none."
        )
    if not choice.channels or _loudness(choice, seconds).rms < SILENT:
        there = f"from {choice.track.start:.2f} to {choice.track.start + seconds:.2f} s " if choice.channels else ""
        raise CaptureError(f"{choice.track.file}: {there}has no sound. Choose another one with --sound, auto or none.")
    return choice


def _best(tracks: dict[str, Track], seconds: float) -> Choice | None:
    """Return the first of the loudest undistorted tracks, or the least distorted one."""
    with ThreadPoolExecutor(threads.count()) as pool:  # FFmpeg releases the interpreter lock
        counts = pool.map(lambda track: channels(track.file, track.files), tracks.values())
        choices = [
            Choice(track, count, name) for (name, track), count in zip(tracks.items(), counts, strict=True) if count
        ]
        found = pool.map(lambda choice: _loudness(choice, seconds), choices)
        audible = {c: loudness for c, loudness in zip(choices, found, strict=True) if loudness.rms >= SILENT}
    clean = [choice for choice in audible if audible[choice].clipped <= CLIPPED]
    if clean:
        loud = AS_LOUD * max(audible[choice].rms for choice in clean)
        best = next(choice for choice in clean if audible[choice].rms >= loud)
        return replace(best, why="the loudest without distortion" if len(audible) > 1 else "")
    if audible:
        return replace(min(audible, key=lambda choice: audible[choice].clipped), why="the least distorted")
    return None


def _loudness(choice: Choice, seconds: float) -> Loudness:
    length = seconds if seconds <= WINDOWS * WINDOW else WINDOW
    starts = [0.0] if length == seconds else np.linspace(0, seconds - WINDOW, WINDOWS).tolist()
    squares, clipped, count = 0.0, 0, 0
    for start in starts:
        for block in choice.samples(length, start):
            squares += float(np.square(block, dtype=np.float64).sum())
            clipped += int((np.abs(block) >= LOUD).sum())
            count += block.size
    return Loudness(math.sqrt(squares / max(count, 1)), clipped / max(count, 1))


def channels(file: Path, files: Files = LOCAL) -> int:
    """Return the number of channels for `read_sound`: 1, or 2 for files with more, or 0 without sound.

    Raises:
        CaptureError: The file cannot be opened.
    """
    with _guard(file), open_media(files, file) as container:
        return min(container.streams.audio[0].layout.nb_channels, 2) if container.streams.audio else 0


def read_sound(file: Path, channels: int, rate: int, start: float = 0.0, files: Files = LOCAL) -> Iterator[np.ndarray]:
    """Yield the sound of a file in blocks [n, channels] float32. Gaps become silence.

    Args:
        file: Sound or video file.
        channels: 1 or 2.
        rate: Samples per second.
        start: Seconds after the first frame, or the first sample of a sound file.
        files: Access to the file.

    Raises:
        CaptureError: The file has no sound, or it cannot be decoded.
    """
    with _guard(file), open_media(files, file) as container:
        if not container.streams.audio:
            raise CaptureError(f"{file}: has no sound.")
        audio = container.streams.audio[0]
        first = main_video(container) or audio
        zero = float((first.start_time or 0) * (first.time_base or 0)) + start
        if start > PREROLL and audio.time_base:
            with suppress(FFmpegError):  # otherwise read from the start of the file
                container.seek(int((zero - PREROLL) / audio.time_base), stream=audio)
        resampler = av.AudioResampler("flt", "mono" if channels == 1 else "stereo", rate)
        now: int | None = None  # position of the next sample, counted from `start`
        for frame in container.decode(audio):
            time = now if frame.time is None else round((frame.time - zero) * rate)
            if now is None:
                now = min(time or 0, 0)
            if time is not None and (now <= 0 < time or time - now > GAP * rate):
                yield np.zeros((time - max(now, 0), channels), np.float32)
                now = time
            for part in resampler.resample(frame):
                block = part.to_ndarray().reshape(-1, channels)
                yield block[max(-now, 0) :]
                now += len(block)
        for part in resampler.resample(None):
            yield part.to_ndarray().reshape(-1, channels)[max(-(now or 0), 0) :]


def _without_first(blocks: Iterator[np.ndarray], count: int) -> Iterator[np.ndarray]:
    for block in blocks:
        yield block[count:]
        count = max(count - len(block), 0)


def _cut(blocks: Iterator[np.ndarray], seconds: float, channels: int) -> Iterator[np.ndarray]:
    left = round(seconds * RATE)
    for block in blocks:
        if left <= 0:
            return
        yield block[:left]
        left -= len(block[:left])
    yield np.zeros((left, channels), np.float32)


@contextmanager
def _guard(file: Path) -> Iterator[None]:
    try:
        yield
    except (FFmpegError, OSError, ValueError) as error:
        raise CaptureError(
            f"{file}: its sound cannot be decoded ({getattr(error, 'strerror', None) or error}). Copy the file again."
        ) from error
