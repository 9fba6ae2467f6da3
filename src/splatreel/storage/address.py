"""Addresses of folders on this machine, on a web server or in a bucket, and all access to their files."""

from __future__ import annotations

import copy
import io
import logging
import random
import re
import time
from collections import OrderedDict
from collections.abc import Callable, Iterable
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar
from urllib.parse import urlsplit
from urllib.request import url2pathname

from splatreel.base.errors import SplatreelError, StorageError, UsageError
from splatreel.storage import web
from splatreel.storage.transport import CREDENTIALS, PLAIN, Bucket, Disk, Headers, Transport, Verdict, is_plain, judge

if TYPE_CHECKING:
    from splatreel.base.untrusted import Kind

T = TypeVar("T")
PAUSES = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
"""Seconds between attempts. A random share of up to a half is added, so that many machines do not retry together."""
Pauses = Iterable[float] | Callable[[], Iterable[float]]
"""Seconds before retries, or a function that returns them for each access."""
_URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+://", re.ASCII)
_WEB = ("http://", "https://")
_READ = "cannot be read"
logger = logging.getLogger("splatreel")


def is_url(text: str) -> bool:
    """Return whether text is a URL such as `s3://bucket/reel`, and not a path with a Windows drive letter."""
    return _URL.match(text) is not None


def local_path(address: str | Path) -> Path | None:
    """Return the local path of an address, or None if the address is remote.

    Raises:
        UsageError: The address is invalid, or `file://HOST/...` with another host.
    """
    text = str(address)
    if not is_url(text):
        return Path(address)
    try:
        split = urlsplit(text)
    except ValueError as error:
        raise UsageError(f"{text}: is not an address ({error}). Correct it.") from error
    if split.scheme.lower() != "file":
        return None
    if split.netloc not in ("", "localhost"):
        raise UsageError(
            f"{text}: is on the host {split.netloc}. Write file:///PATH, with three slashes, for a path here."
        )
    return Path(url2pathname(split.path))


def log_retry(why: str) -> None:
    """Log the reason of a retry. Without a logging setup of the program, it is printed."""
    logger.warning(why)


class Address:
    """Folder at a path, at http(s)://, or at a URL of any protocol that fsspec supports, such as `s3://BUCKET/REEL`.

    Names of files are their paths within the folder, with `/` as separator. Every method repeats an attempt that failed
    because of the connection or the server (HTTP 5xx, 408, 429), but not one that is refused (401, 403), names a
    missing file (404), or is wrong otherwise.

    Credentials and endpoints come from the environment variables and files of the service's own tools, or from
    fsspec's. A query of an http(s) address, such as a signature, is sent with each request.

    Args:
        location: Path or URL of the folder.
        kind: Constructor of the errors that methods raise.
        report: Called with the reason of each retry.
        pauses: Seconds before each retry; None means `PAUSES`. After the last one the error is raised.
        wait: Function that waits for a number of seconds. It may raise to end the retries.
        writes: True to refuse addresses that take no files.

    Raises:
        UsageError: The address is invalid, or takes no files.
        MissingDependencyError: A required Python package is not installed.
        SplatreelError: Of the given kind, if the service cannot be reached.
    """

    def __init__(
        self,
        location: str | Path,
        kind: Kind = StorageError,
        *,
        report: Callable[[str], None] = log_retry,
        pauses: Pauses | None = None,
        wait: Callable[[float], None] = time.sleep,
        writes: bool = False,
    ) -> None:
        self.path = local_path(location)
        """Path of a local folder; None for a remote one."""
        self._kind = kind
        self._report, self._pauses, self._wait = report, pauses, wait
        self._is_down = False
        """True after the last retry failed. Then single attempts find out when the service is back."""
        url = str(location)
        self._shown = str(self.path) if self.path is not None else without_secrets(url)
        self._protocol = "file" if self.path is not None else url.partition("://")[0].lower()
        if writes and url.lower().startswith(_WEB):
            raise UsageError(
                f"{self._shown}: web servers take no files. Give the address of the bucket, such as s3://BUCKET/REEL."
            )
        self._transport = self._open(url)

    def _open(self, url: str) -> Transport:
        if self.path is not None:
            return Disk(self.path, self._kind)
        if not url.lower().startswith(_WEB):
            return self._try(self._shown, "cannot be reached", lambda: Bucket(url, self._shown))
        try:
            return web.Web(url, self._kind)
        except ValueError as error:
            raise UsageError(f"{self._shown}: is not an address ({error}). Correct it.") from error

    def __str__(self) -> str:
        return self._shown

    def name(self, file: str) -> str:
        """Return the name of a file for messages."""
        return f"{self._shown}/{file}" if self.path is None else str(self.path / file)

    def with_retries(
        self,
        report: Callable[[str], None] | None = None,
        pauses: Pauses | None = None,
        wait: Callable[[float], None] | None = None,
    ) -> Address:
        """Return the same address with other retries. None keeps what this one has."""
        other = copy.copy(self)
        other._is_down = False
        other._report = report or self._report
        other._pauses = self._pauses if pauses is None else pauses
        other._wait = wait or self._wait
        return other

    def read(self, file: str, most: int) -> bytes | None:
        """Return the first `most` bytes of a file, or None if the file does not exist."""
        return self._try(self.name(file), _READ, lambda: self._transport.read(file, 0, most), optional=True)

    def fetch(self, file: str, most: int, least: int = 0) -> bytes:
        """Return a whole file. A missing file, or one of more than `most` bytes, is an error.

        Args:
            file: Name of the file.
            most: Maximum size in bytes.
            least: Size in bytes below which a transfer is incomplete and repeated. Files on a disk are returned as they are.
        """
        data = self._try(self.name(file), _READ, lambda: self._whole(self._transport.read(file, 0, most + 1), least))
        if len(data) > most:
            raise self._kind(f"{self.name(file)}: is longer than the {most} bytes it should have.")
        return data

    def read_range(self, file: str, begin: int, end: int) -> bytes:
        """Return the bytes from `begin` to `end` (exclusive) of a file. A missing or shorter file is an error."""
        if end <= begin:
            return b""
        return self._try(
            self.name(file), _READ, lambda: self._whole(self._transport.read(file, begin, end), end - begin)
        )

    def open(self, file: str, size: int) -> RangedFile:
        """Return a file of `size` bytes for random access."""
        return RangedFile(self, file, size)

    def write(self, file: str, data: bytes, headers: Headers = PLAIN) -> None:
        """Create or replace a file. Readers see the old content or the new content, never a part."""
        what = f"could not be written ({len(data)} bytes)"
        self._try(self.name(file), what, lambda: self._transport.write(file, data, headers))

    def sizes(self, prefix: str = "") -> dict[str, int]:
        """Return the sizes in bytes of all files whose name starts with `prefix`, including subfolders but not hidden files."""
        found = self._try(self.name(prefix), "cannot be listed", lambda: self._transport.sizes(prefix))
        return {name: size for name, size in found.items() if name.startswith(prefix) and is_plain(name)}

    def remove(self, file: str) -> None:
        """Delete a file. A missing file is not an error."""
        self._try(self.name(file), "cannot be deleted", lambda: self._transport.remove(file))

    def _whole(self, data: bytes, least: int) -> bytes:
        if len(data) < least and self.path is None:
            raise ConnectionError(f"the transfer ended after {len(data):,} of {least:,} bytes")
        return data

    def _try(self, name: str, what: str, action: Callable[[], T], optional: bool = False) -> Any:
        """Return the result of `action`; None for a missing file if `optional`."""
        begun = time.monotonic()
        pauses = PAUSES if self._pauses is None else self._pauses() if callable(self._pauses) else self._pauses
        for pause in chain(() if self._is_down else pauses, (None,)):
            try:
                result = action()
                self._is_down = False
                return result
            except SplatreelError:
                raise
            except Exception as error:
                verdict, reason = judge(error), _reason(error)
                if verdict is Verdict.MISSING and optional:
                    return None
                late = pause is None or (what == _READ and time.monotonic() - begun > web.PATIENCE)
                if verdict is not Verdict.PASSING or late:
                    self._is_down = verdict is Verdict.PASSING
                    raise self._failure(name, what, reason, verdict) from error
            assert pause is not None
            self._report(f"{name}: {what} ({reason}). Retrying.")
            self._wait(pause * (1 + random.random() / 2))
        raise AssertionError  # the last round returns or raises

    def _failure(self, name: str, what: str, reason: str, verdict: Verdict) -> SplatreelError:
        message = f"{name}: {what} ({reason})."
        if verdict is Verdict.MISSING and what == _READ:
            message = f"{name}: does not exist. Is the name right, and is the folder complete?"
        elif self.path is None:
            advice = {
                Verdict.MISSING: "Does the bucket exist?",
                Verdict.REFUSED: f"The bucket is private, or this file is. {CREDENTIALS.get(self._protocol, CREDENTIALS[''])}",
                Verdict.LASTING: "Check the address.",
                Verdict.PASSING: "Check the address and the connection, and try again.",
            }
            message += f" {advice[verdict]}"
        elif verdict is Verdict.REFUSED:
            message += " Change its permissions."
        error = self._kind(message)
        if isinstance(error, StorageError):
            error.lasting = verdict is not Verdict.PASSING
        return error


def _reason(error: Exception) -> str:
    text = getattr(error, "strerror", None) or str(error)
    return f"{' '.join(str(text).split()) or type(error).__name__:.300}"


def without_secrets(url: str) -> str:
    """Return a URL without its password, and a web address without its query, which may be a signature."""
    scheme, _, rest = url.partition("://")
    host, _, path = rest.partition("/")
    if "@" in host:
        host = f"***@{host.rpartition('@')[2]}"
    if url.lower().startswith(_WEB):
        path = path.partition("?")[0]
    return f"{scheme}://{host}/{path}".rstrip("/") if host else url


BLOCK = 1 << 18
"""Bytes per block."""
KEPT = 16
"""Number of blocks kept in memory."""
AHEAD = 16
"""Maximum number of blocks per request during sequential reads."""


class RangedFile(io.RawIOBase):
    """Read-only seekable file, for FFmpeg and Pillow. Only requested blocks are fetched.

    During sequential reads each request fetches twice as many blocks as the one before, up to `AHEAD`.

    Args:
        address: Folder that holds the file.
        file: Name of the file in the folder.
        size: Size of the file in bytes.
    """

    def __init__(self, address: Address, file: str, size: int) -> None:
        self.name = address.name(file)
        self.fetched = 0
        """Bytes fetched so far."""
        self._address = address
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
            if not part:  # a local file has been truncated
                break
            view[done : done + len(part)] = part
            done += len(part)
            self._at += len(part)
        return done

    def _block(self, index: int) -> bytes:
        if index not in self._blocks:
            self._count = min(2 * self._count, AHEAD) if index == self._expected else 1
            begin, end = index * BLOCK, min((index + self._count) * BLOCK, self._size)
            data = self._address.read_range(self._file, begin, end)
            self.fetched += len(data)
            self._expected = index + self._count
            for place in range(self._count):
                if part := data[place * BLOCK : (place + 1) * BLOCK]:
                    self._blocks[index + place] = part
            while len(self._blocks) > max(KEPT, self._count):
                self._blocks.popitem(last=False)
        return self._blocks.get(index, b"")
