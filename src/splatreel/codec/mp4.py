"""MP4 files: the writer of fragmented files with one Opus track, and checks of boxes before FFmpeg parses a file.

FFmpeg allocates 24 bytes for every sample that a table claims, so a claim is checked first. The boxes are written here because
FFmpeg's writer stores the encoder delay in an edit list, which players interpret differently.

Source:
    ISO/IEC 14496-12 and "Encapsulation of Opus in ISO Base Media File Format".
"""

from __future__ import annotations

import struct
from collections.abc import Iterator

from splatreel.base.errors import ReelError

_PARENTS = {"moov", "trak", "mdia", "minf", "stbl", "edts", "mvex", "moof", "traf"}
_TABLES = {"stsz", "stz2", "stts", "ctts", "trun"}
"""Boxes that state the number of samples."""
_KNOWN = {
    *("ftyp", "styp", "free", "mdat", "sidx", "mvhd", "udta", "tkhd", "elst", "mdhd", "hdlr", "vmhd", "smhd", "dinf", "stsd", "stss"),
    *("stsc", "stco", "co64", "sgpd", "sbgp", "sdtp", "mehd", "trex", "mfhd", "tfhd", "tfdt"),
}  # fmt: skip
_HIDDEN = [name.encode() for name in sorted(_PARENTS | _TABLES | {"cmov"})]


def check_samples(data: bytes, most: int) -> None:
    """Raise `ReelError` for boxes that reels do not contain, or for a track that claims more than `most` samples."""
    in_fragments = 0
    for name, begin, end in _boxes(memoryview(data), 0, len(data)):
        if name in _TABLES:
            claimed = _claimed_samples(name, data[begin:end])
            in_fragments += claimed if name == "trun" else 0
            if max(claimed, in_fragments) > most:
                raise ReelError(f"claims {max(claimed, in_fragments)} samples, at most {most} were expected.")


def _boxes(data: memoryview, begin: int, end: int) -> Iterator[tuple[str, int, int]]:
    """Yield name, start and end of the body of every leaf box."""
    while begin < end:
        size, body = int.from_bytes(data[begin : begin + 4], "big"), begin + 8
        name = bytes(data[begin + 4 : body]).decode("latin-1")
        if size == 1:
            size, body = int.from_bytes(data[body : body + 8], "big"), body + 8
        if size < body - begin or begin + size > end:
            raise ReelError("is not made of whole MP4 boxes.")
        if name in _PARENTS:
            yield from _boxes(data, body, begin + size)
        elif name in _TABLES:
            yield name, body, begin + size
        elif name not in _KNOWN or (name != "mdat" and _contains_box_names(bytes(data[body : begin + size]))):
            raise ReelError(f"holds an MP4 box {name!r} that reels do not contain.")
        begin += size


def _contains_box_names(body: bytes) -> bool:
    """Return whether a body contains names of known boxes. FFmpeg finds some of them there."""
    return any(name in body for name in _HIDDEN)


def _claimed_samples(name: str, body: bytes) -> int:
    if name in ("stsz", "stz2"):
        return int.from_bytes(body[8:12], "big")
    count = int.from_bytes(body[4:8], "big")
    if name == "trun":
        return count
    if 8 + 8 * count > len(body):
        raise ReelError(f"has a truncated table {name!r}.")
    return sum(int.from_bytes(body[at : at + 4], "big") for at in range(8, 8 + 8 * count, 8))


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
