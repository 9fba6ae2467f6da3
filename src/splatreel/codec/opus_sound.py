"""Sound as Opus in fragmented MP4 (docs/format.md): encoding, decoding, and writing into a reel.

A sample's time is its time in the reel; there is no codec delay.
"""

from __future__ import annotations

import hashlib
import io
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import av
import numpy as np
from av.error import FFmpegError

from splatreel.base.errors import MissingDependencyError, ReelError
from splatreel.codec.mp4 import PACKET, RATE, check_samples, initialization, segment
from splatreel.codec.presentation import Asset, Sound, SoundSegment, Vec3
from splatreel.codec.writer import ReelWriter

TYPE = 'audio/mp4; codecs="opus"'
SEGMENT_SECONDS = 2
_BITS_A_SECOND = {1: 64_000, 2: 112_000}
"""Bit rate by number of channels, at which few listeners hear a difference to the original."""
PREROLL = 0.08
"""Seconds after which a decoder that starts in the middle gives the same samples (RFC 7845)."""

_MOST_BYTES, _MOST_A_SECOND = 1 << 16, 1 << 17
"""Maximum size of a segment: a constant for its boxes, and twice the maximum Opus rate of 510 kbit/s per second."""
_SEGMENT = SEGMENT_SECONDS * RATE // PACKET
"""Packets per segment."""


@dataclass(frozen=True)
class EncodedSound:
    """Sound files of a reel. Segment i starts at i * `SEGMENT_SECONDS`.

    Attributes:
        segments: Segments in order.
        samples: Number of samples, in whole packets.
    """

    channels: int
    init: bytes
    segments: tuple[bytes, ...]
    samples: int

    def span(self, index: int) -> tuple[float, float]:
        """Return start and length of a segment in seconds."""
        first = index * _SEGMENT * PACKET
        return first / RATE, min(_SEGMENT * PACKET, self.samples - first) / RATE


class SoundEncoder:
    """Streaming encoder of sound at `RATE` samples per second. The same samples give the same bytes on one machine.

    Args:
        channels: 1 or 2.
        first: Number of the first segment. Pass samples from `begin` on, one second earlier, so that the encoder
            settles.

    Raises:
        MissingDependencyError: PyAV has no libopus.
    """

    def __init__(self, channels: int, first: int = 0) -> None:
        try:
            context = av.CodecContext.create("libopus", "w")
        except (ValueError, FFmpegError) as error:
            raise MissingDependencyError("PyAV has no libopus encoder. Install the `av` wheel from PyPI.") from error
        context.sample_rate, context.layout, context.format = RATE, "mono" if channels == 1 else "stereo", "flt"  # type: ignore[attr-defined]
        context.bit_rate = _BITS_A_SECOND[channels]
        context.options = {"application": "audio", "vbr": "on", "frame_duration": "20"}
        context.open()
        self.channels = channels
        self.begin = max(first * _SEGMENT * PACKET - RATE, 0)
        self.samples = self.begin
        self._context = context
        self._next = first
        self._delay = int.from_bytes((context.extradata or bytes(12))[10:12], "little")
        # A decoder outputs samples `delay` samples late. Silence before them shifts them to the start of the second packet. The first
        # packet is dropped, so that packet k decodes to the samples from k * PACKET on.
        self._unwanted = 1 + first * _SEGMENT - self.begin // PACKET
        self._rest = np.zeros((PACKET - self._delay, channels), np.float32)
        self._packets: list[bytes] = []

    def add(self, block: np.ndarray) -> list[bytes]:
        """Encode samples [n, channels] float32, -1..1, and return the segments that are complete."""
        block = np.asarray(block, np.float32).reshape(-1, self.channels)
        self.samples += len(block)
        self._encode(block)
        return self._complete(_SEGMENT)

    def finish(self) -> list[bytes]:
        """Return the remaining segments. The last packet is padded with silence."""
        self._encode(np.zeros((self._delay + PACKET, self.channels), np.float32))
        self._take(self._context.encode(None))
        count = max(-(-self.samples // PACKET) - self._next * _SEGMENT, 0)
        self._packets = self._packets[:count]
        return self._complete(1)

    def _encode(self, block: np.ndarray) -> None:
        self._rest = np.concatenate([self._rest, block])
        whole = len(self._rest) // PACKET * PACKET
        for first in range(0, whole, PACKET):
            part = np.ascontiguousarray(self._rest[first : first + PACKET], np.float32)
            frame = av.AudioFrame.from_ndarray(part.reshape(1, -1), "flt", "mono" if self.channels == 1 else "stereo")
            frame.sample_rate = RATE
            self._take(self._context.encode(frame))
        self._rest = self._rest[whole:]

    def _take(self, packets: list) -> None:
        for packet in packets:
            if self._unwanted:
                self._unwanted -= 1
            else:
                self._packets.append(bytes(packet))

    def _complete(self, least: int) -> list[bytes]:
        """Return segments of the available packets; the last needs at least `least` packets."""
        made = []
        while len(self._packets) >= least:
            part, self._packets = self._packets[:_SEGMENT], self._packets[_SEGMENT:]
            made.append(segment(self._next, self._next * _SEGMENT * PACKET, part))
            self._next += 1
        return made


def encode_sound(blocks: Iterable[np.ndarray], channels: int) -> EncodedSound:
    """Encode sound from the reel's time 0 on. The same samples give the same bytes on one machine.

    Args:
        blocks: Samples in order, [n, channels] float32, -1..1.
        channels: 1 or 2.

    Raises:
        MissingDependencyError: PyAV has no libopus.
        ReelError: There are no samples.
    """
    encoder = SoundEncoder(channels)
    segments = [made for block in blocks for made in encoder.add(block)]
    if not encoder.samples:
        raise ReelError("There is no sound to encode.")
    segments += encoder.finish()
    return EncodedSound(channels, initialization(channels), tuple(segments), -(-encoder.samples // PACKET) * PACKET)


def decode_sound(init: bytes, segments: list[bytes], channels: int) -> Iterator[tuple[int, np.ndarray]]:
    """Yield the packets of consecutive segments: time in samples, and samples [n, channels] float32.

    Raises:
        ReelError: The data is not sound with this number of channels.
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
        raise ReelError(f"is not sound that can be decoded ({error}).") from error


def check_sound_size(segment: SoundSegment) -> None:
    """Raise `ReelError` for a segment with too many bytes for Opus, before it is downloaded."""
    if segment.asset.bytes > _MOST_BYTES + _MOST_A_SECOND * segment.seconds:
        raise ReelError(
            f"{segment.asset.uri}: has {segment.asset.bytes} bytes for {segment.seconds:g} s, too many for Opus."
        )


def write_sound(writer: ReelWriter, sound: EncodedSound | None, position: Vec3 | None = None) -> None:
    """Write sound, or none, into a reel before its first group.

    Args:
        writer: Writer of the reel.
        sound: Sound to write; None removes the sound.
        position: Position of the source, world units; None if the sound has no position. Segments that a live reel has
            dropped are not written again.
    """
    manifest, before = writer.manifest, writer.manifest.presentation
    described = describe_sound(sound, position).trimmed_before(manifest.first_frame / manifest.fps) if sound else None
    named = {asset.uri for asset in described.assets} if described else set()
    contents = {uri: data for uri, data in _sound_files(sound).items() if uri in named} if sound else {}
    if before.sound == described and _are_there(writer.path, contents):
        return
    writer.present(replace(before, sound=None))
    for uri, data in contents.items():
        writer.write_asset(uri, data)
    writer.present(replace(before, sound=described))


def _sound_files(sound: EncodedSound) -> dict[str, bytes]:
    segments = {f"sound/{index:04d}.m4s": data for index, data in enumerate(sound.segments)}
    return {"sound/init.mp4": sound.init} | segments


def describe_sound(sound: EncodedSound, position: Vec3 | None) -> Sound:
    """Return the manifest's description of sound."""
    init, *assets = (
        Asset(uri, len(data), hashlib.sha256(data).hexdigest()) for uri, data in _sound_files(sound).items()
    )
    segments = tuple(SoundSegment(asset, *sound.span(index)) for index, asset in enumerate(assets))
    return Sound(TYPE, RATE, sound.channels, init, segments, position)


def _are_there(folder: Path, contents: dict[str, bytes]) -> bool:
    return all((folder / uri).is_file() and (folder / uri).read_bytes() == data for uri, data in contents.items())


def _samples(frame: av.AudioFrame) -> np.ndarray:
    """Return the samples of a frame, [n, channels] float32."""
    pcm = frame.to_ndarray()
    pcm = pcm.T if frame.format.is_planar else pcm.reshape(-1, frame.layout.nb_channels)
    return pcm / np.float32(1 << 15) if frame.format.name.startswith("s16") else pcm
