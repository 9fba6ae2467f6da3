"""Checks of MP4 boxes before FFmpeg parses a file. FFmpeg allocates 24 bytes for every sample that a table claims."""

from __future__ import annotations

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
    """Return the number of samples that a table claims."""
    if name in ("stsz", "stz2"):
        return int.from_bytes(body[8:12], "big")
    count = int.from_bytes(body[4:8], "big")
    if name == "trun":
        return count
    if 8 + 8 * count > len(body):
        raise ReelError(f"has a truncated table {name!r}.")
    return sum(int.from_bytes(body[at : at + 4], "big") for at in range(8, 8 + 8 * count, 8))
