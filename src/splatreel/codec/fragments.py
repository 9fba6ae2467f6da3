"""Writer of fragmented MP4 files with one Opus track.

The boxes are written here because FFmpeg's writer stores the encoder delay in an edit list, which players interpret
differently.

Source:
    ISO/IEC 14496-12 and "Encapsulation of Opus in ISO Base Media File Format".
"""

from __future__ import annotations

import struct

RATE = 48_000
"""Samples per second of every Opus stream, and time scale of the track."""
PACKET = 960
"""Samples per packet: 20 ms."""

_MATRIX = struct.pack(">9I", 1 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 30)
_TRACK = 1


def initialization(channels: int) -> bytes:
    """Return the initialization file, which describes the track without samples.

    Pre-skip is 0 and there is no edit list, so a decoded packet is heard at the packet's time.

    Args:
        channels: 1 or 2.
    """
    header = struct.pack(">IIIIIHHQ", 0, 0, 1000, 0, 1 << 16, 1 << 8, 0, 0)
    movie = _full(b"mvhd", 0, 0, header, _MATRIX, bytes(24), struct.pack(">I", _TRACK + 1))
    extends = _box(b"mvex", _full(b"trex", 0, 0, struct.pack(">IIIII", _TRACK, 1, PACKET, 0, 0)))
    return _box(b"ftyp", b"iso6", struct.pack(">I", 0), b"iso6mp41") + _box(b"moov", movie, _track(channels), extends)


def segment(index: int, start: int, packets: list[bytes]) -> bytes:
    """Return consecutive packets as a movie fragment.

    Args:
        index: Number of the segment, from 0.
        start: Time of the first packet in samples.
        packets: Opus packets.
    """
    samples = b"".join(struct.pack(">I", len(packet)) for packet in packets)

    def fragment(offset: int) -> bytes:
        run = _full(b"trun", 0, 0x000201, struct.pack(">II", len(packets), offset), samples)
        header = _full(b"tfhd", 0, 0x020028, struct.pack(">III", _TRACK, PACKET, 0))
        time = _full(b"tfdt", 1, 0, struct.pack(">Q", start))
        return _box(b"moof", _full(b"mfhd", 0, 0, struct.pack(">I", index + 1)), _box(b"traf", header, time, run))

    data = b"".join(packets)
    return fragment(len(fragment(0)) + 8) + _box(b"mdat", data)


def _track(channels: int) -> bytes:
    header = struct.pack(">IIIIIQHHHH", 0, 0, _TRACK, 0, 0, 0, 0, 0, 1 << 8, 0)
    specific = _box(b"dOps", struct.pack(">BBHIhB", 0, channels, 0, RATE, 0, 0))
    entry = _box(b"Opus", bytes(6), struct.pack(">HQHHHHI", 1, 0, channels, 16, 0, 0, RATE << 16), specific)
    tables = [_full(name, 0, 0, struct.pack(">I", 0)) for name in (b"stts", b"stsc")]
    tables += [_full(b"stsz", 0, 0, struct.pack(">II", 0, 0)), _full(b"stco", 0, 0, struct.pack(">I", 0))]
    samples = _box(b"stbl", _full(b"stsd", 0, 0, struct.pack(">I", 1), entry), *tables)
    here = _box(b"dinf", _full(b"dref", 0, 0, struct.pack(">I", 1), _full(b"url ", 0, 1)))
    media = _box(
        b"mdia",
        _full(b"mdhd", 0, 0, struct.pack(">IIIIHH", 0, 0, RATE, 0, 0x55C4, 0)),  # no language
        _full(b"hdlr", 0, 0, bytes(4), b"soun", bytes(12), b"sound\0"),
        _box(b"minf", _full(b"smhd", 0, 0, bytes(4)), here, samples),
    )
    return _box(b"trak", _full(b"tkhd", 0, 7, header, _MATRIX, struct.pack(">II", 0, 0)), media)


def _box(name: bytes, *parts: bytes) -> bytes:
    body = b"".join(parts)
    return struct.pack(">I", 8 + len(body)) + name + body


def _full(name: bytes, version: int, flags: int, *parts: bytes) -> bytes:
    return _box(name, struct.pack(">I", version << 24 | flags), *parts)
