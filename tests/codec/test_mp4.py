"""MP4 files that claim more than they hold are refused before FFmpeg parses them."""

import struct

import pytest

from splatreel.base.errors import ReelError
from splatreel.codec.mp4 import check_samples


def box(name: str, *parts: bytes) -> bytes:
    body = b"".join(parts)
    return struct.pack(">I", 8 + len(body)) + name.encode() + body


def table(name: str, *numbers: int) -> bytes:
    return box(name, struct.pack(f">{1 + len(numbers)}I", 0, *numbers))


def movie(*tables: bytes) -> bytes:
    return box("ftyp", b"isom") + box("moov", box("trak", box("mdia", box("minf", box("stbl", *tables)))))


@pytest.mark.parametrize(
    "data",
    [
        movie(table("stsz", 0, 8), table("stts", 2, 3, 512, 5, 512)),
        box("moof", box("traf", table("trun", 5)), box("traf", table("trun", 3))) + box("mdat", b"stsz trun moov"),
        struct.pack(">I", 1) + b"free" + struct.pack(">Q", 20) + bytes(4),
    ],
)
def test_boxes_of_reels_are_accepted(data: bytes) -> None:
    check_samples(data, 8)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (movie(table("stsz", 1, 9)), "claims 9 samples, at most 8"),
        (movie(table("stts", 2, 5, 512, 4, 512)), "claims 9 samples"),
        (movie(table("ctts", 1, 1 << 31, 0)), "claims 2147483648 samples"),
        (movie(table("stts", 9, 1, 512)), "truncated table 'stts'"),
        (box("moof", box("traf", table("trun", 5))) + box("moof", box("traf", table("trun", 4))), "claims 9 samples"),
        (box("wide", box("moov")), "an MP4 box 'wide'"),
        (box("udta", box("trak", box("stsz"))), "an MP4 box 'udta'"),
        (box("free", b"moov"), "an MP4 box 'free'"),
        (box("moov", struct.pack(">I", 99) + b"trak"), "whole MP4 boxes"),
        (b"\0\0\0\0mdat", "whole MP4 boxes"),
        (b"\0\0\0", "whole MP4 boxes"),
    ],
)
def test_excess_samples_and_hidden_boxes_are_refused(data: bytes, message: str) -> None:
    with pytest.raises(ReelError, match=message):
        check_samples(data, 8)
