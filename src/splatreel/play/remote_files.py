"""Files of a remote reel for a local server, fetched on request."""

from __future__ import annotations

import hashlib
import io
import threading
import time
from collections import OrderedDict

from splatreel.base.errors import ReelError
from splatreel.codec.file_entry import FileEntry
from splatreel.codec.manifest import MAX_BYTES, Manifest, parse_manifest
from splatreel.codec.manifest_pages import Known, PageEntry
from splatreel.codec.presentation import Asset, Presentation
from splatreel.codec.source import open_source
from splatreel.play.served_files import MANIFEST, OpenFile

FRESH = 1.0
"""Seconds for which a fetched manifest counts as current."""
CACHE_BYTES = 128 << 20
"""Bytes of files kept in memory, so that a second viewer, or a range request, does not fetch them again."""


class RemoteFiles:
    """`ReelFiles` of a remote reel."""

    def __init__(self, url: str) -> None:
        """Fetch the manifest. url: of the reel or of its manifest. Raises `ReelError` if there is no reel."""
        self._source = open_source(url)
        self._looking = threading.Lock()
        self._keeping = threading.Lock()
        self._files: OrderedDict[str, bytes] = OrderedDict()
        self._pages: Known = {}
        self._data = self._source.read(MANIFEST, MAX_BYTES)
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
                data = self._source.read(MANIFEST, MAX_BYTES)
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
        return parse_manifest(data, self._source.name(MANIFEST), self._source.read, known=self._pages)

    def _read(self, entry: Entry) -> bytes:
        with self._keeping:
            if entry.sha256 in self._files:
                self._files.move_to_end(entry.sha256)
                return self._files[entry.sha256]
        data = self._source.read(entry.uri, entry.bytes)
        if hashlib.sha256(data).hexdigest() != entry.sha256:
            raise ReelError(
                f"{self._source.name(entry.uri)}: its sha256 differs from the manifest. Publish the reel again."
            )
        with self._keeping:
            self._files[entry.sha256] = data
            while sum(map(len, self._files.values())) > CACHE_BYTES:
                self._files.popitem(last=False)
        return data


Entry = FileEntry | Asset | PageEntry


def _entries(manifest: Manifest) -> dict[str, Entry]:
    return {entry.uri: entry for entry in (*manifest.files, *manifest.assets, *manifest.pages)}
