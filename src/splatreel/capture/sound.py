"""The sound that a capture's videos hold: reading it, and choosing the best track."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import av
import numpy as np
from av.error import FFmpegError

from splatreel.errors import CaptureError

RATE = 48_000
"""Samples a second of what is read."""
LOUD = 0.99
"""A sample of this size is taken for a clipped one."""
CLIPPED = 1e-4
"""Share of clipped samples, some five a second, up to which a track counts as undistorted."""
SILENT = 1e-5
"""Root mean square below which a track holds nothing: 100 dB below full scale."""


GAP = 0.02
"""Seconds by which a file's times may be off what came before; beyond, something is missing, and silence takes its place."""


@dataclass(frozen=True)
class Track:
    """Where the sound of some frames is: in a file, from `start` seconds after its first picture on."""

    file: Path
    start: float


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

    def samples(self, seconds: float) -> Iterator[np.ndarray]:
        """Blocks of [n, channels] float32 at `RATE` a second, so many seconds in all; silence where there is none."""
        blocks = read_sound(self.track.file, self.channels, RATE, self.track.start)
        yield from _cut(blocks, seconds, self.channels)


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
        return _best({name: track for name, track in tracks.items() if channels(track.file)}, seconds)
    if wanted in tracks:
        choice = Choice(tracks[wanted], channels(tracks[wanted].file), wanted)
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
    choices = [Choice(track, channels(track.file), name) for name, track in tracks.items()]
    heard = {choice: _loudness(choice, seconds) for choice in choices}
    heard = {choice: loudness for choice, loudness in heard.items() if loudness.rms >= SILENT}
    clean = [choice for choice in heard if heard[choice].clipped <= CLIPPED]
    if clean:
        best = max(clean, key=lambda choice: heard[choice].rms)
        return replace(best, why="the loudest without distortion" if len(heard) > 1 else "")
    if heard:
        return replace(min(heard, key=lambda choice: heard[choice].clipped), why="the least distorted")
    return None


def _loudness(choice: Choice, seconds: float) -> Loudness:
    squares, clipped, count = 0.0, 0, 0
    for block in choice.samples(seconds):
        squares += float(np.square(block, dtype=np.float64).sum())
        clipped += int((np.abs(block) >= LOUD).sum())
        count += block.size
    return Loudness(math.sqrt(squares / max(count, 1)), clipped / max(count, 1))


def channels(file: Path) -> int:
    """How many `read_sound` shall give of a file: 1, or 2 where it has more; 0 where it has no sound.

    Raises `CaptureError` where it cannot be opened.
    """
    with _guard(file), av.open(str(file)) as container:
        return min(container.streams.audio[0].layout.nb_channels, 2) if container.streams.audio else 0


def read_sound(file: Path, channels: int, rate: int, start: float = 0.0) -> Iterator[np.ndarray]:
    """The sound of a file in blocks, [n, channels] float32, from `start` seconds after its first picture (or sound) on, to its end.

    channels: 1 or 2. Silence where something is missing, as before a sound that begins later. Raises `CaptureError` for a file
    without sound or one that cannot be decoded.
    """
    with _guard(file), av.open(str(file)) as container:
        if not container.streams.audio:
            raise CaptureError(f"{file}: has no sound.")
        audio = container.streams.audio[0]
        first = container.streams.video[0] if container.streams.video else audio
        zero = float((first.start_time or 0) * (first.time_base or 0)) + start
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
    except (FFmpegError, ValueError) as error:
        raise CaptureError(
            f"{file}: its sound cannot be decoded ({getattr(error, 'strerror', None) or error}). Copy the file again."
        ) from error
