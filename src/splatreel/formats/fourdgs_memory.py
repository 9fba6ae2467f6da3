"""Memory that reading a .4dgs file takes, from the headers of its chunks and streams.

A stream of one repeated value takes a few bytes of the file for any number of points, and a zstd frame states a size that
its decoder allocates. The package fourdgs limits each stream to half a gigabyte, but not their sum.
"""

from __future__ import annotations

import struct
from typing import Any

from splatreel.base.errors import GaussiansError
from splatreel.base.memory_budget import MemoryBudget, points_memory

_STREAM = struct.Struct("<BBBBBIQ")
"""Header of a stream: attribute, width, mode, codec, channels, count, length."""
_NUMBER = 16
"""Bytes of memory per number of a stream: its symbol, and the decoded integer."""
_CODECS = {"deflate": 0, "zstd": 1}


def check_memory(data: bytes, source: str, budget: MemoryBudget) -> None:
    """Raise `GaussiansError` if reading a .4dgs file takes too much memory. Damaged files are left to their reader.

    Args:
        data: The file.
        source: Name of the file.
        budget: Memory that reading may take.
    """
    from fourdgs import exceptions, opcode, records, serialization  # pyright: ignore[reportMissingImports] - optional

    needed = len(data)
    try:
        for record in serialization.iter_records(data, len(serialization.MAGIC)):
            if record.opcode == opcode.SH_BAND_STREAM:
                needed += _streams_memory(bytes(record.content[1:]))
            elif record.opcode == opcode.CHUNK:
                head, block = records.parse_chunk(record.content)
                needed += points_memory(head.count) + head.uncompressed_size
                budget.check(needed, len(data), source, f"chunks of up to {head.count:,} points")
                needed += _streams_memory(_unpacked(head, bytes(block), serialization))
            budget.check(needed, len(data), source, "streams of repeated numbers")
    except GaussiansError:
        raise
    except (exceptions.FourdgsError, ValueError, struct.error):
        return


def _unpacked(head: Any, block: bytes, serialization: Any) -> bytes:
    """Return the streams of a chunk, whose size was checked."""
    codec = _CODECS.get(head.compression)
    if codec is None:
        return block
    if codec == _CODECS["zstd"] and _zstd_size(block) > head.uncompressed_size:
        raise ValueError("a zstd frame of another size")
    return serialization.decompress(block, codec, head.uncompressed_size)


def _streams_memory(block: bytes) -> int:
    """Return the bytes of memory that decoding streams takes, one after the other."""
    needed = at = 0
    while at + _STREAM.size <= len(block):
        *_, codec, channels, count, length = _STREAM.unpack_from(block, at)
        at += _STREAM.size
        needed += _NUMBER * channels * count
        if codec == _CODECS["zstd"]:
            needed += _zstd_size(block[at : at + length])
        at += length
    return needed


def _zstd_size(frame: bytes) -> int:
    """Return the size that a zstd frame states; 0 if it states none, or is damaged.

    Its reader refuses a damaged frame, or skips it if it belongs to an unknown attribute and goes on with the next chunk.
    """
    try:
        import zstandard  # pyright: ignore[reportMissingImports] - optional
    except ImportError:
        return 0
    try:
        return max(zstandard.frame_content_size(frame), 0)
    except (ValueError, zstandard.ZstdError):
        return 0
