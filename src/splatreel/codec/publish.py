"""Publishing: a copy of a local reel in remote storage, from which web pages play it, also while the reel is written."""

from __future__ import annotations

import hashlib
import json
import math
import re
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain, repeat
from pathlib import Path, PurePosixPath
from queue import Empty, SimpleQueue
from typing import Any, TypeVar

from splatreel.base.errors import CancelledError, ReelError, SplatreelError, StorageError
from splatreel.base.process import steady_clock
from splatreel.base.progress import Progress, Silent
from splatreel.base.untrusted import open_regular
from splatreel.codec.document import in_lines, parse_object
from splatreel.codec.manifest import MANIFEST, MAX_BYTES, Known, parse_manifest
from splatreel.storage.address import PAUSES, Address
from splatreel.storage.transport import Headers

T = TypeVar("T")
HOUR = 3600.0
KEPT = 24 * HOUR
"""Grace period, in seconds, before unreferenced files are deleted. Players that loaded an older manifest still request them."""
AT_ONCE = 4
"""Files sent in parallel."""
_MANIFESTS = 5
"""Attempts to send a reel that changes meanwhile."""
RECORD = "publication.json"
_TYPES = {".json": "application/json", ".mp4": "audio/mp4", ".m4s": "audio/mp4", ".jpg": "image/jpeg"}
_CHANGING, _LASTING = "no-cache", "public, max-age=31536000, immutable"
_DIGITS = 16
_OURS = re.compile(
    r"(?:(?:layers|groups)/[\w.-]+-[0-9a-f]{16}\.safetensors|sound/[\w.-]+-[0-9a-f]{16}\.(?:mp4|m4s)"
    r"|pages/[\w.-]+-[0-9a-f]{16}\.json|thumbnails/[\w.-]+-[0-9a-f]{16}\.jpg|poster-[0-9a-f]{16}\.jpg)",
    re.ASCII,
)


@dataclass(frozen=True)
class Published:
    """State of a publication.

    Attributes:
        files: Files of the whole reel without the manifest.
        bytes: Size of these files.
        sent: Files sent by this update.
        sent_bytes: Size of the sent files.
        removed: Files deleted after the grace period.
        live: True while the reel is still being written.
    """

    files: int
    bytes: int
    sent: int
    sent_bytes: int
    removed: int
    live: bool


@dataclass(frozen=True)
class _File:
    """File to be sent. If `data` is None, it is read from `uri`."""

    uri: str
    name: str
    bytes: int
    sha256: str
    data: bytes | None = None


class Publication:
    """Copy of the reel in directory `reel` at `address`.

    Each published file is named by its content (`published_name`). The manifest with these names is sent last. Any
    manifest that was ever published therefore finds all its files until `keep` seconds after a newer manifest no longer
    names them. A file that exists with the right name and length is never sent again, whatever was interrupted before.

    Args:
        reel: Directory of the reel.
        address: Folder of the copy.
        keep: Grace period in seconds.
        clock: Function that returns seconds since 1970; by default the system's clock when the publication begins, which then runs
            on evenly. A clock that is set meanwhile would end the grace period early or never.
    """

    def __init__(
        self, reel: Path, address: Address, keep: float = KEPT, clock: Callable[[], float] | None = None
    ) -> None:
        self.reel = reel
        self.address = address
        self.sent = 0
        self._lock = threading.Lock()
        self._keep = keep
        self._clock = clock or steady_clock()
        self._there: dict[str, int] | None = None
        self._manifest_there: bytes | None = None
        self._left: dict[str, float] | None = None
        self._known: Known = {}
        self._pages: dict[str, tuple[_File, list[_File]]] = {}

    def update(self, progress: Progress | None = None) -> Published | None:
        """Send missing files and the manifest. After an error, another call continues.

        Returns:
            The state of the publication, or None if there is no reel yet but the folder can be reached.

        Raises:
            StorageError: The folder cannot be reached or refuses access.
            ReelError: The local reel is damaged.
        """
        for _ in range(_MANIFESTS):
            data = self._read_here(MANIFEST, MAX_BYTES)
            if data is None:
                self._list()
                return None
            try:
                return self._send(data, progress or Silent())
            except ReelError:  # the local reel may have changed meanwhile
                if self._read_here(MANIFEST, MAX_BYTES) == data:
                    raise
            except StorageError:
                self._there = None  # the file may have arrived despite the error
                raise
        raise StorageError(f"{self.address.name(MANIFEST)}: the reel changes faster than it can be sent there.")

    def _send(self, data: bytes, progress: Progress) -> Published:
        document = self._checked(data)
        files, pages = self._renamed(document)
        named = {file.name: file.bytes for file in (*files, *pages)}
        there = self._list()
        missing = {file.name: file for file in files if there.get(file.name) != file.bytes}
        before = self.sent
        if missing:
            progress.stage("sending the reel", sum(file.bytes for file in missing.values()))
        self._send_all(list(missing.values()), progress)
        new_pages = [page for page in pages if there.get(page.name) != page.bytes]
        self._send_all(new_pages, Silent())
        text = _to_bytes(document)
        if text != self._manifest_there:
            self.address.write(MANIFEST, text, headers_of(MANIFEST))
            self._manifest_there = text
        return Published(
            files=len(named),
            bytes=sum(named.values()),
            sent=self.sent - before,
            sent_bytes=sum(file.bytes for file in (*missing.values(), *new_pages)),
            removed=self._remove_unreferenced(set(named)),
            live=bool(document["live"]),
        )

    def _checked(self, data: bytes) -> dict[str, Any]:
        parse_manifest(data, str(self.reel / MANIFEST), Address(self.reel, ReelError).fetch, known=self._known)
        return parse_object(data)

    def _renamed(self, document: dict[str, Any]) -> tuple[list[_File], list[_File]]:
        """Return the files and pages of a manifest, and replace their names in it by the published names."""
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
        """Return a page with published names, and its files. Pages never change, so each is read once."""
        known = self._pages.get(entry["sha256"])
        if known is not None:
            return known
        page = parse_object(self._read_intact(_File(entry["uri"], "", entry["bytes"], entry["sha256"])))
        files, data = _rename(page), _to_bytes(page)
        digest = hashlib.sha256(data).hexdigest()
        return _File(entry["uri"], published_name(entry["uri"], digest), len(data), digest, data), files

    def _list(self) -> dict[str, int]:
        if self._there is None:
            self._manifest_there = self.address.read(MANIFEST, MAX_BYTES + 1)
            self._there = self.address.sizes()
        return self._there

    def _send_all(self, files: list[_File], progress: Progress) -> None:
        done = 0
        for file in transfer_in_threads(self._send_file, files, AT_ONCE):
            done += file.bytes
            progress.update(done)

    def _send_file(self, file: _File) -> None:
        data = self._read_intact(file) if file.data is None else file.data
        self.address.write(file.name, data, headers_of(file.name))
        with self._lock:
            self.sent += 1
            self._list()[file.name] = len(data)

    def _read_intact(self, file: _File) -> bytes:
        data = self._read_here(file.uri, file.bytes)
        if data is None or len(data) != file.bytes or hashlib.sha256(data).hexdigest() != file.sha256:
            raise ReelError(f"{self.reel / file.uri}: does not match the manifest. Run splatreel verify.")
        return data

    def _read_here(self, uri: str, most: int) -> bytes | None:
        """Read a local file, at most one byte more than `most`."""
        try:
            with open_regular(self.reel / uri, ReelError) as file:
                return file.read(most + 1)
        except FileNotFoundError:
            return None
        except OSError as error:
            raise ReelError(f"{self.reel / uri}: cannot be read ({error.strerror}).") from error

    def _remove_unreferenced(self, named: set[str]) -> int:
        """Delete files past their grace period and return their number.

        A file beside the manifest records when they were last referenced. Times in the future are of a clock that was set back
        since: the grace period starts again.
        """
        there, now, noted = self._list(), self._clock(), self._read_record()
        unnamed = [name for name in sorted(there) if is_published_name(name) and name not in named]
        left = {name: min(noted.get(name, now), now) for name in unnamed}
        if left != noted:
            self._write_record(left)
        old = [name for name, since in left.items() if now - since >= self._keep]
        for name in old:
            self.address.remove(name)
            del there[name], left[name]
        if old:
            self._write_record(left)
        return len(old)

    def _read_record(self) -> dict[str, float]:
        """Return since when files are unreferenced. An unreadable record starts over."""
        if self._left is None:
            data = self.address.read(RECORD, MAX_BYTES) or b"{}"
            try:
                left = parse_object(data).get("left", {})
                self._left = {name: float(since) for name, since in dict(left).items() if math.isfinite(float(since))}
            except (ReelError, TypeError, ValueError, OverflowError):
                self._left = {}
        return self._left

    def _write_record(self, left: dict[str, float]) -> None:
        data = json.dumps({"generator": "splatreel", "left": left}, indent=1).encode()
        self.address.write(RECORD, data, headers_of(RECORD))
        self._left = dict(left)


class BackgroundPublication:
    """Thread that updates a publication after each call of `changed`, without delaying the program that writes the reel.

    While the reel is being written, transfers that fail because of the connection are repeated without end. Other
    errors are reported, and the next change is another attempt. The thread starts with an update, which checks that
    the address can be reached.

    Args:
        publication: Publication to update.
        report: Called from the thread when failures start and when they end.
        pauses: Seconds between retries. Until the reel is complete, the last one repeats.

    Attributes:
        failure: Error of the last update, or None if it succeeded.
    """

    def __init__(
        self, publication: Publication, report: Callable[[str], None], pauses: tuple[float, ...] = PAUSES
    ) -> None:
        self._publication = publication
        self._report = report
        self._pauses = pauses
        self._condition = threading.Condition()
        self._changed = True
        self._ending = False
        self._stopped = False
        self._has_failed = False
        self._published: Published | None = None
        self.failure: SplatreelError | None = None
        self._bug: BaseException | None = None
        publication.address = publication.address.with_retries(self._report_first, self._until_complete, self._pause)
        self._thread = threading.Thread(target=self._run, name="splatreel-publication", daemon=True)
        self._thread.start()

    def changed(self) -> None:
        """Request an update and return immediately."""
        with self._condition:
            self._changed = True
            self._condition.notify()

    def finish(self) -> Published | None:
        """Wait until the whole reel is published.

        Returns:
            The result of the last update, or None if there is no reel.

        Raises:
            SplatreelError: Publishing was given up.
        """
        with self._condition:
            self._changed = self._ending = True
            self._condition.notify()
        while self._thread.is_alive():
            self._thread.join(0.5)  # wake up regularly to handle signals
        for error in (self._bug, self.failure):
            if error is not None:
                raise error
        return self._published

    def stop(self) -> None:
        """Stop publishing immediately. A transfer in progress may still complete."""
        with self._condition:
            self._stopped = True
            self._condition.notify()

    def _until_complete(self) -> Iterator[float]:
        """Yield the seconds between retries of a transfer: without end until the reel is complete, then all once more."""
        for pause in chain(self._pauses, repeat(self._pauses[-1])):
            if self._ending:
                break
            yield pause
        yield from self._pauses

    def _run(self) -> None:
        try:
            while self._wait():
                self._update()
        except CancelledError:
            pass  # by `stop`
        except BaseException as error:  # a bug; `finish` raises it
            self._bug = error

    def _wait(self) -> bool:
        """Wait for a change. Return False when the thread should end."""
        with self._condition:
            self._condition.wait_for(lambda: self._changed or self._ending or self._stopped)
            go_on = self._changed and not self._stopped
            self._changed = False
            return go_on

    def _update(self) -> None:
        self._publication.address = self._publication.address.with_retries()  # all of them once more
        try:
            self._published = self._publication.update()
            self.failure = None
        except CancelledError:
            raise
        except SplatreelError as error:
            self._report_first(f"{error} Retrying after the next group.")
            self.failure = error
            return
        if self._has_failed:
            self._has_failed = False
            self._report(f"{self._publication.address}: is reachable again; everything so far is published.")

    def _report_first(self, why: str) -> None:
        """Report the first failure since the last success."""
        with self._condition:
            is_first, self._has_failed = not self._has_failed, True
        if is_first:
            self._report(why)

    def _pause(self, seconds: float) -> None:
        """Wait before a retry. The wait ends early when the reel is complete, or with `CancelledError` when the thread is stopped."""
        with self._condition:
            ending = self._ending
            self._condition.wait_for(lambda: self._stopped or self._ending != ending, timeout=seconds)
            if self._stopped:
                raise CancelledError("Publishing was stopped.")


def transfer_in_threads(action: Callable[[T], object], items: Iterable[T], threads: int) -> Iterator[T]:
    """Call `action` for each item in a number of threads and yield finished items.

    After an error no further item is started. The first error is raised when all started items have ended. Ctrl-C does
    not wait for transfers: a transfer over a dead connection may take minutes to fail. A standard thread pool would
    wait for it even at exit.
    """
    waiting: SimpleQueue[T] = SimpleQueue()
    for item in items:
        waiting.put(item)
    done: SimpleQueue[tuple[T, BaseException | None] | None] = SimpleQueue()
    stopped = threading.Event()

    def work() -> None:
        while not stopped.is_set():
            try:
                item = waiting.get_nowait()
            except Empty:
                break
            try:
                action(item)
            except BaseException as error:
                stopped.set()
                done.put((item, error))
            else:
                done.put((item, None))
        done.put(None)

    workers = [threading.Thread(target=work, daemon=True) for _ in range(min(threads, waiting.qsize()))]
    for worker in workers:
        worker.start()
    left, failure = len(workers), None
    try:
        while left:
            result = done.get()
            if result is None:
                left -= 1
            elif result[1] is not None:
                failure = failure or result[1]
            else:
                yield result[0]
    finally:
        stopped.set()
    if failure is not None:
        raise failure


def _rename(value: Any) -> list[_File]:
    """Return all files named in JSON, and replace their names in it by the published names."""
    files = []
    for entry in file_entries(value):
        name = published_name(entry["uri"], entry["sha256"])
        files.append(_File(entry["uri"], name, entry["bytes"], entry["sha256"]))
        entry["uri"] = name
    return files


def _to_bytes(document: dict[str, Any]) -> bytes:
    return in_lines(document).encode()


def published_name(uri: str, sha256: str) -> str:
    """Convert `groups/0003.safetensors` to `groups/0003-0123456789abcdef.safetensors`. A converted name stays the same."""
    path = PurePosixPath(uri)
    end = f"-{sha256[:_DIGITS]}"
    return uri if path.stem.endswith(end) else str(path.with_name(f"{path.stem}{end}{path.suffix}"))


def is_published_name(name: str) -> bool:
    """Return whether a name can only belong to a published reel. Other files are never deleted."""
    return _OURS.fullmatch(name) is not None


def headers_of(name: str) -> Headers:
    """Return the HTTP headers of a file. Names with a digest may be cached forever; the manifest must be revalidated."""
    kind = _TYPES.get(PurePosixPath(name).suffix, "application/octet-stream")
    return Headers(kind, _CHANGING if name in (MANIFEST, RECORD) else _LASTING)


def file_entries(value: Any) -> Iterator[dict[str, Any]]:
    """Yield every JSON object of a manifest or page that names a file by `uri`, `bytes` and `sha256`."""
    if isinstance(value, Mapping):
        if isinstance(value, dict) and all(name in value for name in ("uri", "bytes", "sha256")):
            yield value
        for part in value.values():
            yield from file_entries(part)
    elif isinstance(value, list):
        for part in value:
            yield from file_entries(part)
