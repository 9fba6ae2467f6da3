"""A reel of this machine, kept as a copy elsewhere from which web pages play it, also while it grows."""

from __future__ import annotations

import hashlib
import json
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from splatreel.codec.document import in_lines, parse_object
from splatreel.codec.manifest import MAX_BYTES, parse_manifest
from splatreel.codec.manifest_pages import Known
from splatreel.codec.published_names import (
    MANIFEST,
    RECORD,
    file_entries,
    headers_of,
    is_published_name,
    published_name,
)
from splatreel.codec.source import open_source
from splatreel.errors import ReelError, StorageError
from splatreel.progress import Progress, Silent
from splatreel.storage.folder import Folder
from splatreel.storage.parallel_transfers import transfer_in_threads

HOUR = 3600.0
KEPT = 24 * HOUR
"""Seconds that files stay which the manifest names no more: who opened the reel before still asks for them."""
AT_ONCE = 4
"""Files that are sent at a time."""
_MANIFESTS = 5
"""How often is begun anew where the reel changes while it is sent."""


@dataclass(frozen=True)
class Published:
    """What is there now. files, bytes: of the whole reel without the manifest. sent, sent_bytes: of those what was not there before."""

    files: int
    bytes: int
    sent: int
    sent_bytes: int
    removed: int
    live: bool


@dataclass(frozen=True)
class _File:
    """A file to be sent. data: None where it is read from `uri`."""

    uri: str
    name: str
    bytes: int
    sha256: str
    data: bytes | None = None


class Publication:
    """The copy in `folder` of the reel in the directory `reel`; `update` brings it up to date.

    Every file is named there by its content (`published_names`), and the manifest, which names them so, is sent last: who has any
    manifest that ever was there finds all its files, for `keep` seconds after a newer one names them no more. So what is there under
    its name, in its length, need never be sent again, whatever was cut off before.

    clock: seconds since 1970.
    """

    def __init__(self, reel: Path, folder: Folder, keep: float = KEPT, clock: Callable[[], float] = time.time) -> None:
        self.reel, self.folder = reel, folder
        self.sent = 0
        self._lock = threading.Lock()
        self._keep, self._clock = keep, clock
        self._there: dict[str, int] | None = None
        self._manifest_there: bytes | None = None
        self._left: dict[str, float] | None = None
        self._known: Known = {}
        self._pages: dict[str, tuple[_File, list[_File]]] = {}

    def update(self, progress: Progress | None = None) -> Published | None:
        """Send what is not there yet; None where there is no reel here yet, but the folder is reached. Call it again after an error, to
        go on.

        Raises `StorageError` where the folder cannot be reached or refuses, `ReelError` for a reel that is damaged here.
        """
        for _ in range(_MANIFESTS):
            data = self._read_here(MANIFEST, MAX_BYTES)
            if data is None:
                self._look()
                return None
            try:
                return self._send(data, progress or Silent())
            except ReelError:  # a file may be gone, or another one, because the reel here is another one by now
                if self._read_here(MANIFEST, MAX_BYTES) == data:
                    raise
            except StorageError:
                self._there = None  # it may have arrived all the same
                raise
        raise StorageError(f"{self.folder.address(MANIFEST)}: the reel changes faster than it can be sent there.")

    def _send(self, data: bytes, progress: Progress) -> Published:
        document = self._checked(data)
        files, pages = self._renamed(document)
        named = {file.name: file.bytes for file in (*files, *pages)}
        there = self._look()
        missing = {file.name: file for file in files if there.get(file.name) != file.bytes}
        before = self.sent
        if missing:
            progress.stage("sending the reel", sum(file.bytes for file in missing.values()))
        self._send_all(list(missing.values()), progress)
        new_pages = [page for page in pages if there.get(page.name) != page.bytes]
        self._send_all(new_pages, Silent())
        text = _text(document)
        if text != self._manifest_there:
            self.folder.write(MANIFEST, text, headers_of(MANIFEST))
            self._manifest_there = text
        return Published(
            files=len(named),
            bytes=sum(named.values()),
            sent=self.sent - before,
            sent_bytes=sum(file.bytes for file in (*missing.values(), *new_pages)),
            removed=self._tidy(set(named)),
            live=bool(document["live"]),
        )

    def _checked(self, data: bytes) -> dict[str, Any]:
        parse_manifest(data, str(self.reel / MANIFEST), open_source(self.reel).read, known=self._known)
        return parse_object(data)

    def _renamed(self, document: dict[str, Any]) -> tuple[list[_File], list[_File]]:
        """The files and the pages that a manifest names, which then names them as they are called there."""
        entries = document.pop("pages", None)
        files = _rename(document)
        if entries is None:
            return files, []
        pages = []
        self._pages = {entry["sha256"]: self._page(entry) for entry in entries}
        for entry in entries:
            page, own = self._pages[entry["sha256"]]
            entry |= {"uri": page.name, "bytes": page.bytes, "sha256": page.sha256}
            pages.append(page)
            files += own
        document["pages"] = entries
        return files, pages

    def _page(self, entry: dict[str, Any]) -> tuple[_File, list[_File]]:
        """A page as it is called and reads there, and its files; pages never change, so that each is read once."""
        known = self._pages.get(entry["sha256"])
        if known is not None:
            return known
        page = parse_object(self._intact(_File(entry["uri"], "", entry["bytes"], entry["sha256"])))
        files, data = _rename(page), _text(page)
        digest = hashlib.sha256(data).hexdigest()
        return _File(entry["uri"], published_name(entry["uri"], digest), len(data), digest, data), files

    def _look(self) -> dict[str, int]:
        if self._there is None:
            self._manifest_there = self.folder.read(MANIFEST, MAX_BYTES + 1)
            self._there = self.folder.sizes()
        return self._there

    def _send_all(self, files: list[_File], progress: Progress) -> None:
        done = 0
        for file in transfer_in_threads(self._send_file, files, AT_ONCE):
            done += file.bytes
            progress.update(done)

    def _send_file(self, file: _File) -> None:
        data = self._intact(file) if file.data is None else file.data
        self.folder.write(file.name, data, headers_of(file.name))
        with self._lock:
            self.sent += 1
            self._look()[file.name] = len(data)

    def _intact(self, file: _File) -> bytes:
        data = self._read_here(file.uri, file.bytes)
        if data is None or len(data) != file.bytes or hashlib.sha256(data).hexdigest() != file.sha256:
            raise ReelError(f"{self.reel / file.uri}: is not what the manifest says. Run splatreel verify.")
        return data

    def _read_here(self, uri: str, most: int) -> bytes | None:
        """Up to one byte more than `most`."""
        try:
            with open(self.reel / uri, "rb") as file:
                return file.read(most + 1)
        except FileNotFoundError:
            return None
        except OSError as error:
            raise ReelError(f"{self.reel / uri}: cannot be read ({error.strerror}).") from error

    def _tidy(self, named: set[str]) -> int:
        """Delete what has not been named for long enough; returns how many files. Since when is noted in a file beside the manifest."""
        there, now, noted = self._look(), self._clock(), self._noted()
        left = {name: noted.get(name, now) for name in sorted(there) if is_published_name(name) and name not in named}
        if left.keys() != noted.keys():
            self._note(left)
        old = [name for name, since in left.items() if now - since >= self._keep]
        for name in old:
            self.folder.remove(name)
            del there[name], left[name]
        if old:
            self._note(left)
        return len(old)

    def _noted(self) -> dict[str, float]:
        """Since when files are not named any more; a note that cannot be read begins anew."""
        if self._left is None:
            data = self.folder.read(RECORD, MAX_BYTES) or b"{}"
            try:
                left = parse_object(data).get("left", {})
                self._left = {name: float(since) for name, since in dict(left).items()}
            except (ReelError, TypeError, ValueError):
                self._left = {}
        return self._left

    def _note(self, left: dict[str, float]) -> None:
        data = json.dumps({"generator": "splatreel", "left": left}, indent=1).encode()
        self.folder.write(RECORD, data, headers_of(RECORD))
        self._left = dict(left)


def _rename(value: Any) -> list[_File]:
    """All files that the JSON names, which names them afterwards as they are called there."""
    files = []
    for entry in file_entries(value):
        name = published_name(entry["uri"], entry["sha256"])
        files.append(_File(entry["uri"], name, entry["bytes"], entry["sha256"]))
        entry["uri"] = name
    return files


def _text(document: dict[str, Any]) -> bytes:
    return in_lines(document).encode()
