"""An MP4 file without its pictures: its tables as they are, and zeros in place of what they describe."""

from __future__ import annotations

import io
from bisect import bisect_right
from typing import BinaryIO

SUFFIXES = (".mp4", ".m4v", ".mov")
"""Names of files whose tables say all that a demultiplexer must know of frames."""
PAYLOAD = b"mdat"


class IndexOnly:
    """A file as PyAV reads it, of which only the tables are read from the disk or the network.

    Demultiplexing it gives the times and the sizes of all frames. A video of an hour has some megabytes of tables.
    """

    def __init__(self, file: BinaryIO) -> None:
        self.name = file.name
        self._file, self._at = file, 0
        self._size = file.seek(0, io.SEEK_END)
        self._begins, self._ends = self._payload()

    def read(self, count: int) -> bytes:
        count = max(min(count, self._size - self._at), 0)
        place = bisect_right(self._begins, self._at) - 1
        if place >= 0 and self._at < self._ends[place]:
            data = bytes(min(count, self._ends[place] - self._at))
        else:
            after = self._begins[place + 1] if place + 1 < len(self._begins) else self._size
            self._file.seek(self._at)
            data = self._file.read(min(count, after - self._at))
        self._at += len(data)
        return data

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        self._at = {io.SEEK_SET: 0, io.SEEK_CUR: self._at, io.SEEK_END: self._size}[whence] + offset
        return self._at

    def tell(self) -> int:
        return self._at

    def close(self) -> None:
        self._file.close()

    def _payload(self) -> tuple[list[int], list[int]]:
        """Return where the contents of top-level boxes of pictures begin and end."""
        begins, ends, at = [], [], 0
        while at + 8 <= self._size:
            self._file.seek(at)
            head = self._file.read(16)
            size, kind, length = int.from_bytes(head[:4], "big"), head[4:8], 8
            if size == 1:
                size, length = int.from_bytes(head[8:16], "big"), 16
            end = self._size if size == 0 else min(at + size, self._size)
            if end < at + length:
                break
            if kind == PAYLOAD:
                begins.append(at + length)
                ends.append(end)
            at = end
        return begins, ends
