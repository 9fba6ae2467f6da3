"""Files of a reel that a server may send: the manifest and the files that it names."""

from __future__ import annotations

import hashlib
import io
import os
import threading
import time
from collections import OrderedDict
from pathlib import Path
from typing import BinaryIO, NamedTuple, Protocol

from splatreel.base.errors import ReelError
from splatreel.base.untrusted import read_file
from splatreel.codec.manifest import MANIFEST, MAX_BYTES, FileEntry, Known, Manifest, PageEntry, parse_manifest
from splatreel.codec.presentation import EMPTY, Asset, Presentation
from splatreel.codec.preview import newest_preview
from splatreel.codec.reader import reel_address
from splatreel.storage.address import Address

FRESH = 1.0
"""Seconds for which a fetched manifest counts as current."""
CACHE_BYTES = 128 << 20
"""Bytes of remote files kept in memory, so that a second viewer, or a range request, does not fetch them again."""
PAUSES = (0.5, 1.0, 2.0)
"""Seconds before retries. There are few, because players retry too."""


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
                    read_file(file, MAX_BYTES, ReelError),
                    MANIFEST,
                    Address(self._reel, ReelError).fetch,
                    known=self._pages,
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


Entry = FileEntry | Asset | PageEntry


class RemoteFiles:
    """`ReelFiles` of a remote reel, fetched on request."""

    def __init__(self, url: str) -> None:
        """Fetch the manifest. url: of the reel or of its manifest. Raises `ReelError` if there is no reel."""
        self._address = reel_address(url).with_retries(pauses=PAUSES)
        self._looking = threading.Lock()
        self._keeping = threading.Lock()
        self._files: OrderedDict[str, bytes] = OrderedDict()
        self._pages: Known = {}
        self._data = self._address.fetch(MANIFEST, MAX_BYTES)
        self._manifest = self._parsed(self._data)
        self._entries = _entries(self._manifest)
        self._looked = time.monotonic()
        self._modified = time.time()

    def open(self, name: str) -> OpenFile | None:
        """Fetch the file of this path within the reel. See `ReelFiles`."""
        self._refresh()
        if name == MANIFEST:
            return self._opened(self._data)
        entry = self._entries.get(name)
        return None if entry is None else self._opened(self._read(entry))

    def presentation(self) -> tuple[Presentation, float]:
        """Return the metadata of the reel. See `ReelFiles`."""
        self._refresh()
        return self._manifest.presentation, self._modified

    def _opened(self, data: bytes) -> OpenFile:
        return OpenFile(io.BytesIO(data), len(data), f'"{hashlib.sha256(data).hexdigest()[:32]}"', self._modified)

    def _refresh(self) -> None:
        """Fetch the manifest again if it is no longer current. Keep the old one if that fails."""
        with self._looking:
            if time.monotonic() - self._looked < FRESH:
                return
            try:
                data = self._address.with_retries(pauses=()).fetch(MANIFEST, MAX_BYTES)
                if data != self._data:
                    manifest = self._parsed(data)
                    self._entries = self._merged_entries(manifest)
                    self._data = data
                    self._manifest = manifest
                    self._modified = time.time()
            except ReelError:
                return
            finally:
                self._looked = time.monotonic()

    def _merged_entries(self, manifest: Manifest) -> dict[str, Entry]:
        """Return the files of the old and the new manifest, since clients may still hold the old one."""
        return _entries(self._manifest) | _entries(manifest)

    def _parsed(self, data: bytes) -> Manifest:
        return parse_manifest(data, self._address.name(MANIFEST), self._address.fetch, known=self._pages)

    def _read(self, entry: Entry) -> bytes:
        with self._keeping:
            if entry.sha256 in self._files:
                self._files.move_to_end(entry.sha256)
                return self._files[entry.sha256]
        data = self._address.fetch(entry.uri, entry.bytes, entry.bytes)
        if hashlib.sha256(data).hexdigest() != entry.sha256:
            raise ReelError(
                f"{self._address.name(entry.uri)}: its sha256 differs from the manifest. Publish the reel again."
            )
        with self._keeping:
            self._files[entry.sha256] = data
            while sum(map(len, self._files.values())) > CACHE_BYTES:
                self._files.popitem(last=False)
        return data


def _entries(manifest: Manifest) -> dict[str, Entry]:
    return {entry.uri: entry for entry in (*manifest.files, *manifest.assets, *manifest.pages)}
