"""The sound that a capture's videos hold: reading it, and choosing the best track."""

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

from splatreel import threads
from splatreel.capture.files import LOCAL, Files, open_media
from splatreel.errors import CaptureError

RATE = 48_000
"""Samples a second of what is read."""
LOUD = 0.99
"""A sample of this size is taken for a clipped one."""
CLIPPED = 1e-4
"""Share of clipped samples, some five a second, up to which a track counts as undistorted."""
SILENT = 1e-5
"""Root mean square below which a track holds nothing: 100 dB below full scale."""
WINDOWS, WINDOW = 12, 5.0
"""By so many stretches of so many seconds a long track is judged."""
PREROLL = 2.0
"""Seconds that are decoded before what is wanted: a decoder has to come into step."""
GAP = 0.02
"""Seconds by which a file's times may be off what came before; beyond, something is missing, and silence takes its place."""


@dataclass(frozen=True)
class Track:
    """Where the sound of some frames is.

    Attributes:
        file: A file, by which it is known whether there is any sound.
        start: Seconds after its first picture from which on the sound is wanted.
        files: Where the file lies.
        blocks: Gives the sound of so many channels from `start` on, in blocks of [n, channels], where it is in several files.
    """

    file: Path
    start: float
    files: Files = LOCAL
    blocks: Callable[[int], Iterator[np.ndarray]] | None = None

    def read(self, channels: int, skip: float = 0.0) -> Iterator[np.ndarray]:
        """Yield blocks of [n, channels] float32 at `RATE` a second, from `skip` seconds after `start` on."""
        if self.blocks is None:
            return read_sound(self.file, channels, RATE, self.start + skip, self.files)
        return _without_first(self.blocks(channels), round(skip * RATE))


@dataclass(frozen=True)
class Choice:
    """The track to take. channels: 1 or 2. camera: whose it is; None for a file of its own. why: for people, after the name."""

    track: Track
    channels: int
    camera: str | None
    why: str = ""

    def __str__(self) -> str:
        name = f"camera {self.camera}" if self.camera is not None else str(self.track.file)
        return f"{name} ({self.why})" if self.why else name

    def samples(self, seconds: float, skip: float = 0.0) -> Iterator[np.ndarray]:
        """Yield blocks of [n, channels] float32 at `RATE` a second, so many seconds in all; silence where there is none.

        Args:
            seconds: How many.
            skip: Seconds to leave out at the start.
        """
        yield from _cut(self.track.read(self.channels, skip), seconds, self.channels)


@dataclass(frozen=True)
class Loudness:
    """Of a track: root mean square of the samples, and the share of clipped ones."""

    rms: float
    clipped: float


def choose(wanted: str, tracks: dict[str, Track], seconds: float, begin: float, path: Path) -> Choice | None:
    """The sound for a reel of so many seconds; None where there is none, or none is wanted.

    wanted: auto, none, the name of a camera, or a file. tracks: of the cameras whose pictures are videos. begin: seconds from the
    start of the capture to the reel's first frame, from which on a file is taken. path: of the capture, for messages.
    Raises `CaptureError` for a camera or a file that has no sound in these frames, or cannot be read.
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
    """The loudest of the undistorted ones; where all are distorted, the least distorted one."""
    with ThreadPoolExecutor(threads.count()) as pool:  # FFmpeg works without the interpreter lock
        counts = pool.map(lambda track: channels(track.file, track.files), tracks.values())
        choices = [
            Choice(track, count, name) for (name, track), count in zip(tracks.items(), counts, strict=True) if count
        ]
        found = pool.map(lambda choice: _loudness(choice, seconds), choices)
        heard = {c: loudness for c, loudness in zip(choices, found, strict=True) if loudness.rms >= SILENT}
    clean = [choice for choice in heard if heard[choice].clipped <= CLIPPED]
    if clean:
        best = max(clean, key=lambda choice: heard[choice].rms)
        return replace(best, why="the loudest without distortion" if len(heard) > 1 else "")
    if heard:
        return replace(min(heard, key=lambda choice: heard[choice].clipped), why="the least distorted")
    return None


def _loudness(choice: Choice, seconds: float) -> Loudness:
    """Listen to all of a short track, and to `WINDOWS` parts of a long one."""
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
    """How many `read_sound` shall give of a file: 1, or 2 where it has more; 0 where it has no sound.

    Raises `CaptureError` where it cannot be opened.
    """
    with _guard(file), open_media(files, file) as container:
        return min(container.streams.audio[0].layout.nb_channels, 2) if container.streams.audio else 0


def read_sound(file: Path, channels: int, rate: int, start: float = 0.0, files: Files = LOCAL) -> Iterator[np.ndarray]:
    """Yield the sound of a file to its end, in blocks of [n, channels] float32. Where something is missing is silence.

    Args:
        file: A file of sound or video.
        channels: 1 or 2.
        rate: Samples a second.
        start: Seconds after the first picture, or else the first sound, to begin at.
        files: Where the file lies.

    Raises:
        CaptureError: The file has no sound, or it cannot be decoded.
    """
    with _guard(file), open_media(files, file) as container:
        if not container.streams.audio:
            raise CaptureError(f"{file}: has no sound.")
        audio = container.streams.audio[0]
        first = container.streams.video[0] if container.streams.video else audio
        zero = float((first.start_time or 0) * (first.time_base or 0)) + start
        if start > PREROLL and audio.time_base:
            with suppress(FFmpegError):  # then it is read from the start of the file
                container.seek(int((zero - PREROLL) / audio.time_base), stream=audio)
        resampler = av.AudioResampler("flt", "mono" if channels == 1 else "stereo", rate)
        now: int | None = None  # where the next sample belongs, in samples from `start` on
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
    """FFmpeg's errors as ours."""
    try:
        yield
    except (FFmpegError, OSError, ValueError) as error:
        raise CaptureError(
            f"{file}: its sound cannot be decoded ({getattr(error, 'strerror', None) or error}). Copy the file again."
        ) from error
