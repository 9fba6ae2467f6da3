"""The files of a reel that a server may send: the manifest and the files that it names."""

from __future__ import annotations

import os
import threading
from pathlib import Path
from typing import BinaryIO, NamedTuple, Protocol

from splatreel.base.errors import ReelError
from splatreel.base.untrusted import read_file
from splatreel.codec.manifest import MAX_BYTES, parse_manifest
from splatreel.codec.manifest_pages import Known
from splatreel.codec.presentation import EMPTY, Presentation
from splatreel.codec.preview import newest_preview
from splatreel.codec.source import open_source

MANIFEST = "manifest.json"


class OpenFile(NamedTuple):
    """An open file, which the caller closes."""

    file: BinaryIO
    size: int
    tag: str
    """Entity tag, with its quotes."""
    modified: float
    """Time of the last change, in seconds since 1970."""


class ReelFiles(Protocol):
    """The files of a reel that a server may send. Thread-safe."""

    def open(self, name: str) -> OpenFile | None:
        """Open the file of this path within the reel; None if the manifest does not name it or it does not exist.

        Raises:
            OSError: The file cannot be read.
            ReelError: The file cannot be fetched from another machine.
        """
        ...

    def presentation(self) -> tuple[Presentation, float]:
        """Return the metadata of the reel, and the time at which its manifest was written, in seconds since 1970."""
        ...


def open_file(path: Path) -> OpenFile:
    """Open a local file. Raises OSError."""
    file = path.open("rb", buffering=0)
    status = os.fstat(file.fileno())
    return OpenFile(file, status.st_size, f'"{status.st_mtime_ns:x}-{status.st_size:x}"', status.st_mtime)


class ServedFiles:
    """`ReelFiles` of a local reel. The manifest is read again when it changes, as that of a live reel does."""

    def __init__(self, reel: Path) -> None:
        """Serve the reel in a folder."""
        self._reel = reel.resolve()
        self._lock = threading.Lock()
        self._seen: tuple[int, int, int] | None = None
        self._names = frozenset({MANIFEST})
        self._presentation = EMPTY
        self._modified = 0.0
        self._pages: Known = {}

    def open(self, name: str) -> OpenFile | None:
        """Open a file. See `ReelFiles`."""
        path = self.find(name)
        return open_file(path) if path else None

    def find(self, name: str) -> Path | None:
        """Return the resolved path of a file that the manifest names; None if there is none within the reel."""
        with self._lock:
            self._refresh()
            if name not in self._names:
                return None
        try:
            path = (self._reel / name).resolve()
            return path if path.is_relative_to(self._reel) and path.is_file() else None
        except (OSError, RuntimeError):  # a symlink loop
            return None

    def presentation(self) -> tuple[Presentation, float]:
        """Return the metadata of the reel. See `ReelFiles`."""
        with self._lock:
            self._refresh()
            return self._presentation, self._modified

    def _refresh(self) -> None:
        """Read the manifest again if it changed. An invalid one names no files; the player, which receives it, reports the error."""
        file = self._reel / MANIFEST
        try:
            status = file.stat()
            seen = status.st_mtime_ns, status.st_size, status.st_ino
            if seen == self._seen:
                return
            self._names = frozenset({MANIFEST})
            self._presentation = EMPTY
            self._modified = status.st_mtime
            self._seen = seen
            if file.is_file() and status.st_size <= MAX_BYTES:
                manifest = parse_manifest(
                    read_file(file, MAX_BYTES, ReelError), MANIFEST, open_source(self._reel).read, known=self._pages
                )
                self._names = frozenset({MANIFEST, *manifest.uris})
                self._presentation = manifest.presentation
        except (OSError, ReelError):
            return


class RunFiles:
    """`ReelFiles` of a run: its reel, or a preview of its first keyframe until the reel has a group.

    Args:
        out: Output folder of the run. It may still be missing.
    """

    def __init__(self, out: Path) -> None:
        self._out = out
        self._reel = ServedFiles(out / "reel")
        self._lock = threading.Lock()
        self._preview: tuple[Path, ServedFiles] | None = None

    def open(self, name: str) -> OpenFile | None:
        """Open a file. See `ReelFiles`."""
        return self._now().open(name)

    def presentation(self) -> tuple[Presentation, float]:
        """Return the metadata of the reel. See `ReelFiles`."""
        return self._now().presentation()

    @property
    def shows(self) -> bool:
        """True if there is a reel or a preview."""
        return self._now().find(MANIFEST) is not None

    def _now(self) -> ServedFiles:
        if (self._out / "reel" / MANIFEST).is_file():
            return self._reel
        newest = newest_preview(self._out)
        if newest is None:
            return self._reel
        with self._lock:
            if self._preview is None or self._preview[0] != newest:
                self._preview = newest, ServedFiles(newest)
            return self._preview[1]
