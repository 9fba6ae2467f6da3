"""Sound of videos that are still being written, and the choice of a track before the whole sound is known."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import av
import numpy as np
from av.error import FFmpegError

from splatreel.base.errors import CaptureError
from splatreel.capture.capture_sound import GAP, RATE, Track, channels, choose

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
