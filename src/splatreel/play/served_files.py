"""Which files of a reel's folder are served: the manifest and what it names, and no others that lie there."""

from __future__ import annotations

import os
import threading
from pathlib import Path
from typing import BinaryIO, NamedTuple, Protocol

from splatreel.codec.manifest import MAX_BYTES, parse_manifest
from splatreel.codec.manifest_pages import Known
from splatreel.codec.presentation import EMPTY, Presentation
from splatreel.codec.source import open_source
from splatreel.errors import ReelError

MANIFEST = "manifest.json"


class OpenFile(NamedTuple):
    """Its bytes, their number, entity tag, and time of the last change, seconds since 1970. Who gets it closes it."""

    file: BinaryIO
    size: int
    tag: str
    modified: float


class ReelFiles(Protocol):
    """The files of a reel that a server gives away. For any thread."""

    def open(self, name: str) -> OpenFile | None:
        """The file of this path within the reel; None where the manifest does not name it, or there is none.

        Raises OSError where it cannot be read, and `ReelError` where that is the fault of another machine.
        """
        ...

    def presentation(self) -> tuple[Presentation, float]:
        """What the reel says of itself, and when its manifest was written, seconds since 1970."""
        ...


def open_file(path: Path) -> OpenFile:
    """A file of this machine. Raises OSError."""
    file = path.open("rb", buffering=0)
    status = os.fstat(file.fileno())
    return OpenFile(file, status.st_size, f'"{status.st_mtime_ns:x}-{status.st_size:x}"', status.st_mtime)


class ServedFiles:
    """The manifest of a reel as it is now: it is read again when the file changes, as that of a live reel does. For any thread."""

    def __init__(self, reel: Path) -> None:
        self._reel = reel.resolve()
        self._lock = threading.Lock()
        self._seen: tuple[int, int, int] | None = None
        self._names = frozenset({MANIFEST})
        self._presentation = EMPTY
        self._modified = 0.0
        self._pages: Known = {}

    def open(self, name: str) -> OpenFile | None:
        """See `ReelFiles`."""
        path = self.find(name)
        return open_file(path) if path else None

    def find(self, name: str) -> Path | None:
        """The file of this path within the reel, links resolved; None where there is none, or the manifest does not name it."""
        with self._lock:
            self._refresh()
            if name not in self._names:
                return None
        try:
            path = (self._reel / name).resolve()
            return path if path.is_relative_to(self._reel) and path.is_file() else None
        except (OSError, RuntimeError):  # a loop of links
            return None

    def presentation(self) -> tuple[Presentation, float]:
        """What the reel says of itself, and when its manifest was written, seconds since 1970."""
        with self._lock:
            self._refresh()
            return self._presentation, self._modified

    def _refresh(self) -> None:
        """A manifest that cannot be read names nothing: the player, which gets it, says what is wrong."""
        file = self._reel / MANIFEST
        try:
            status = file.stat()
            seen = status.st_mtime_ns, status.st_size, status.st_ino
            if seen == self._seen:
                return
            self._names, self._presentation, self._modified = frozenset({MANIFEST}), EMPTY, status.st_mtime
            self._seen = seen
            if file.is_file() and status.st_size <= MAX_BYTES:
                manifest = parse_manifest(file.read_bytes(), MANIFEST, open_source(self._reel).read, known=self._pages)
                self._names, self._presentation = frozenset({MANIFEST, *manifest.uris}), manifest.presentation
        except (OSError, ReelError):
            return
