"""Sound as Opus in fragmented MP4 (docs/format.md): samples to files and back. A sample's time is the reel's, without any delay."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import av
import numpy as np
from av.error import FFmpegError

from splatreel.codec.boxes import check_samples
from splatreel.codec.fragments import PACKET, RATE, initialization, segment
from splatreel.codec.presentation import Asset, Sound, SoundSegment, Vec3
from splatreel.codec.writer import ReelWriter
from splatreel.errors import MissingDependencyError, ReelError

TYPE = 'audio/mp4; codecs="opus"'
SEGMENT_SECONDS = 2
BITS_A_SECOND = {1: 64_000, 2: 112_000}
"""By channels: where few hear a difference to the original."""
PREROLL = 0.08
"""Seconds after which a decoder that starts in the middle gives what one that started before does (RFC 7845)."""

_MOST_BYTES, _MOST_A_SECOND = 1 << 16, 1 << 17
"""Of a segment: for what is around its packets, and twice the 510 kbit/s that are the most of Opus."""
_SEGMENT = SEGMENT_SECONDS * RATE // PACKET
"""Packets of a segment."""


@dataclass(frozen=True)
class EncodedSound:
    """The files of a reel's sound. Segment i starts at i * `SEGMENT_SECONDS`; samples: in all, whole packets."""

    channels: int
    init: bytes
    segments: tuple[bytes, ...]
    samples: int

    def span(self, index: int) -> tuple[float, float]:
        """Start and length of a segment in seconds."""
        first = index * _SEGMENT * PACKET
        return first / RATE, min(_SEGMENT * PACKET, self.samples - first) / RATE


def encode_sound(blocks: Iterable[np.ndarray], channels: int) -> EncodedSound:
    """Encode sound at `RATE` samples a second from the reel's time 0 on; the same samples give the same bytes on one machine.

    blocks: [n, channels] float32, -1..1, in order; channels: 1 or 2. The last packet is filled up with silence.
    Raises `MissingDependencyError` without libopus, `ReelError` for no sample at all.
    """
    packets: list[bytes] = []
    count = 0

    def counted() -> Iterator[np.ndarray]:
        nonlocal count
        for block in blocks:
            count += len(block)
            yield np.asarray(block, np.float32).reshape(-1, channels)

    try:
        context = av.CodecContext.create("libopus", "w")
    except (ValueError, FFmpegError) as error:
        raise MissingDependencyError("PyAV has no libopus encoder. Install the `av` wheel from PyPI.") from error
    context.sample_rate, context.layout, context.format = RATE, "mono" if channels == 1 else "stereo", "flt"  # type: ignore[attr-defined]
    context.bit_rate = BITS_A_SECOND[channels]
    context.options = {"application": "audio", "vbr": "on", "frame_duration": "20"}
    context.open()
    delay = int.from_bytes((context.extradata or bytes(12))[10:12], "little")
    # What goes in comes out of a decoder `delay` samples later. So much silence goes before it that it comes out with the second
    # packet; the first is left out, and then packet k decodes to the samples from k * PACKET on.
    silence = np.zeros((PACKET - delay, channels), np.float32)
    for frame in _frames(_chain(silence, counted(), np.zeros((delay + PACKET, channels), np.float32))):
        packets += [bytes(packet) for packet in context.encode(frame)]
    packets += [bytes(packet) for packet in context.encode(None)]
    if not count:
        raise ReelError("There is no sound to encode.")
    packets = packets[1 : 1 + -(-count // PACKET)]
    cut = [packets[first : first + _SEGMENT] for first in range(0, len(packets), _SEGMENT)]
    segments = tuple(segment(i, i * _SEGMENT * PACKET, part) for i, part in enumerate(cut))
    return EncodedSound(channels, initialization(channels), segments, len(packets) * PACKET)


def decode_sound(init: bytes, segments: list[bytes], channels: int) -> Iterator[tuple[int, np.ndarray]]:
    """What consecutive segments hold, packet by packet: the reel's time in samples, and [n, channels] float32.

    Raises `ReelError` if they are anything else than sound of so many channels.
    """
    data = init + b"".join(segments)
    check_samples(data, len(data))
    try:
        with av.open(io.BytesIO(data), "r", format="mov") as container:
            if len(container.streams) != 1 or not container.streams.audio:
                raise ReelError("is not one track of sound.")
            stream = container.streams.audio[0]
            if stream.codec_context is None or stream.codec_context.name not in ("opus", "libopus"):
                raise ReelError("is not Opus.")
            stream.codec_context.thread_type = "NONE"
            for frame in container.decode(stream):
                if (frame.sample_rate, frame.layout.nb_channels) != (RATE, channels):
                    found = f"{frame.layout.nb_channels} channels at {frame.sample_rate} a second"
                    raise ReelError(f"has {found}, expected {channels} at {RATE}.")
                if frame.pts is None or frame.time_base is None:
                    raise ReelError("has a packet without a time.")
                yield round(frame.pts * frame.time_base * RATE), _samples(frame)
    except (FFmpegError, ValueError, EOFError) as error:
        raise ReelError(f"is no sound that can be decoded ({error}).") from error


def check_size(segment: SoundSegment) -> None:
    """Raises `ReelError` for a segment of so many bytes that it cannot be Opus: who reads a second shall not read a gigabyte."""
    if segment.asset.bytes > _MOST_BYTES + _MOST_A_SECOND * segment.seconds:
        raise ReelError(
            f"{segment.asset.uri}: has {segment.asset.bytes} bytes for {segment.seconds:g} s, too many for Opus."
        )


def write_sound(writer: ReelWriter, sound: EncodedSound | None, position: Vec3 | None = None) -> None:
    """Give a reel that is being written this sound, or none; before its first group, so that it has it from then on.

    position: where it comes from, world units; None: from everywhere. What a live reel has dropped already stays away.
    """
    manifest, before = writer.manifest, writer.manifest.presentation
    described = describe(sound, position).since(manifest.first_frame / manifest.fps) if sound else None
    named = {asset.uri for asset in described.assets} if described else set()
    contents = {uri: data for uri, data in files(sound).items() if uri in named} if sound else {}
    if before.sound == described and _are_there(writer.path, contents):
        return
    writer.present(replace(before, sound=None))
    for uri, data in contents.items():
        writer.write_asset(uri, data)
    writer.present(replace(before, sound=described))


def files(sound: EncodedSound) -> dict[str, bytes]:
    """By uri."""
    segments = {f"sound/{index:04d}.m4s": data for index, data in enumerate(sound.segments)}
    return {"sound/init.mp4": sound.init} | segments


def describe(sound: EncodedSound, position: Vec3 | None) -> Sound:
    """What the manifest says of it."""
    init, *assets = (Asset(uri, len(data), hashlib.sha256(data).hexdigest()) for uri, data in files(sound).items())
    segments = tuple(SoundSegment(asset, *sound.span(index)) for index, asset in enumerate(assets))
    return Sound(TYPE, RATE, sound.channels, init, segments, position)


def _are_there(folder: Path, contents: dict[str, bytes]) -> bool:
    return all((folder / uri).is_file() and (folder / uri).read_bytes() == data for uri, data in contents.items())


def _samples(frame: av.AudioFrame) -> np.ndarray:
    """[n, channels] float32."""
    pcm = frame.to_ndarray()
    pcm = pcm.T if frame.format.is_planar else pcm.reshape(-1, frame.layout.nb_channels)
    return pcm / np.float32(1 << 15) if frame.format.name.startswith("s16") else pcm


def _chain(before: np.ndarray, blocks: Iterator[np.ndarray], after: np.ndarray) -> Iterator[np.ndarray]:
    yield before
    yield from blocks
    yield after


def _frames(blocks: Iterable[np.ndarray]) -> Iterator[av.AudioFrame]:
    """Packets' worth of samples; what is left over at the end is dropped."""
    rest, done = None, 0
    for block in blocks:
        rest = block if rest is None else np.concatenate([rest, block])
        whole = len(rest) // PACKET * PACKET
        for first in range(0, whole, PACKET):
            part = np.ascontiguousarray(rest[first : first + PACKET], np.float32)
            frame = av.AudioFrame.from_ndarray(part.reshape(1, -1), "flt", "mono" if part.shape[1] == 1 else "stereo")
            frame.sample_rate, frame.pts = RATE, done
            done += PACKET
            yield frame
        rest = rest[whole:]
