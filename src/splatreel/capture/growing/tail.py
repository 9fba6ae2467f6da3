"""Reading a file while another program writes it: the end of what is there is not the end of the file."""

from __future__ import annotations

from pathlib import Path
from threading import Event
from typing import BinaryIO

from splatreel.capture.growing.growth import Growth


class Tail:
    """A file as FFmpeg reads a stream, from its start on. `read` waits for bytes that are not written yet, until it has ended.

    left: set when nobody reads it any more.
    """

    def __init__(self, path: Path, growth: Growth, left: Event) -> None:
        self.name = str(path)
        self._path, self._growth, self._left = path, growth, left
        self._file: BinaryIO | None = None

    def read(self, count: int) -> bytes:
        """At least one byte; none at the end. Raises OSError where the file cannot be read."""
        while True:
            if self._growth.stopped or self._left.is_set():
                return b""
            ended = self._growth.ended  # asked first: what was written before the end is still read
            data = self._there(count)
            if data or ended:
                return data
            self._growth.pause()

    def close(self) -> None:
        if self._file is not None:
            self._file.close()

    def _there(self, count: int) -> bytes:
        if self._file is None:
            try:
                self._file = open(self._path, "rb", buffering=0)  # noqa: SIM115 - `close` closes it
            except FileNotFoundError:
                return b""
        return self._file.read(count)
