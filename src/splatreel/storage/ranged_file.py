"""Random access to a file in a remote folder. Only requested blocks are fetched."""

from __future__ import annotations

import io
from collections import OrderedDict
from typing import Any

from splatreel.storage.folder import Folder

BLOCK = 1 << 18
"""Bytes per block."""
KEPT = 16
"""Number of blocks kept in memory."""
AHEAD = 16
"""Maximum number of blocks per request during sequential reads."""


class RangedFile(io.RawIOBase):
    """Read-only seekable file, for FFmpeg and Pillow.

    During sequential reads each request fetches twice as many blocks as the one before, up to `AHEAD`.

    Args:
        folder: The folder that holds the file.
        file: Name of the file in the folder.
        size: Size of the file in bytes.
    """

    def __init__(self, folder: Folder, file: str, size: int) -> None:
        self.name = folder.address(file)
        self.fetched = 0
        """Bytes fetched so far."""
        self._folder = folder
        self._file = file
        self._size = size
        self._at = 0
        self._blocks: OrderedDict[int, bytes] = OrderedDict()
        self._expected = -1
        self._count = 1

    def readable(self) -> bool:
        """Return True."""
        return True

    def seekable(self) -> bool:
        """Return True."""
        return True

    def tell(self) -> int:
        """Return the position."""
        return self._at

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        """Set the position."""
        base = {io.SEEK_SET: 0, io.SEEK_CUR: self._at, io.SEEK_END: self._size}[whence]
        self._at = max(base + offset, 0)
        return self._at

    def readinto(self, buffer: Any, /) -> int:
        """Read into a buffer and return the number of bytes."""
        view = memoryview(buffer).cast("B")
        wanted = max(min(len(view), self._size - self._at), 0)
        done = 0
        while done < wanted:
            index, within = divmod(self._at, BLOCK)
            part = self._block(index)[within : within + wanted - done]
            if not part:  # the file has been truncated
                break
            view[done : done + len(part)] = part
            done += len(part)
            self._at += len(part)
        return done

    def _block(self, index: int) -> bytes:
        if index not in self._blocks:
            self._count = min(2 * self._count, AHEAD) if index == self._expected else 1
            begin, end = index * BLOCK, min((index + self._count) * BLOCK, self._size)
            data = self._folder.read_range(self._file, begin, end)
            self.fetched += len(data)
            self._expected = index + self._count
            for place in range(self._count):
                if part := data[place * BLOCK : (place + 1) * BLOCK]:
                    self._blocks[index + place] = part
            while len(self._blocks) > max(KEPT, self._count):
                self._blocks.popitem(last=False)
        return self._blocks.get(index, b"")
