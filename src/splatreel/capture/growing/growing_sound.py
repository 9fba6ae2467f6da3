"""The sound of videos that are still being written, as far as it is there, and choosing one when nobody knows how it goes on."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import av
import numpy as np
from av.error import FFmpegError

from splatreel.capture.soundtrack import GAP, RATE, Track, channels, choose
from splatreel.errors import CaptureError

Packets = Iterator[tuple[float, av.Packet]]
"""Packets of one sound track, which may be in several files, each with the seconds by which its own time is more than the camera's."""


def read_packets(packets: Packets, count: int, start: float) -> Iterator[np.ndarray]:
    """Decoded, in blocks [n, count] float32 of `RATE` from `start` seconds after the camera's first picture on.

    Silence where something is missing; what comes twice is heard once. Files that follow each other are decoded as one, since a decoder
    that begins anew has to come into step. count: channels, 1 or 2. Raises `CaptureError` for what cannot be decoded.
    """
    context: av.AudioCodecContext | None = None
    resampler = av.AudioResampler("flt", "mono" if count == 1 else "stereo", RATE)
    now: int | None = None  # samples that were given
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


def begin_with(wanted: str, files: dict[str, Path], seconds: float, path: Path) -> tuple[str, int] | None:
    """The camera whose sound to take, and its channels; None where there is none, or none is wanted.

    wanted: auto, none, or the name of a camera. files: of the cameras, as far as they are written. seconds: to judge by; if none can be
    heard in them, the first camera that has a track is taken. path: of the capture, for messages. Raises `CaptureError` for another.
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
def guard(file: Path) -> Iterator[None]:
    """FFmpeg's errors as ours."""
    try:
        yield
    except (FFmpegError, OSError, ValueError) as error:
        raise CaptureError(
            f"{file}: its sound cannot be decoded ({getattr(error, 'strerror', None) or error})."
        ) from error


def _decoded(context: av.AudioCodecContext, packet: av.Packet) -> list[av.AudioFrame]:
    return context.decode(packet) if packet.size else []


def _resampled(resampler: av.AudioResampler, frame: av.AudioFrame) -> Iterator[np.ndarray]:
    frame.pts = None  # files may count anew
    for part in resampler.resample(frame):
        yield part.to_ndarray()
