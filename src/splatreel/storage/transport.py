"""Interface of a protocol that reaches files, the local disk, and the meaning of each protocol's errors."""

from __future__ import annotations

import contextlib
import enum
import errno
import os
import re
import socket
import ssl
from collections.abc import Iterator
from http.client import InvalidURL
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from splatreel.base.atomic import remove, replacing, sweep

if TYPE_CHECKING:
    from splatreel.base.untrusted import Kind

_NAME = re.compile(r"[^/\\.\x00-\x1f][^/\\\x00-\x1f]*(/[^/\\.\x00-\x1f][^/\\\x00-\x1f]*)*")


class Headers(NamedTuple):
    """HTTP headers that a web host sends with a file: `Content-Type` and `Cache-Control`."""

    type: str = "application/octet-stream"
    caching: str = "no-cache"


PLAIN = Headers()


class Transport(Protocol):
    """Files in a folder, named by their paths with `/` as separator.

    The methods raise the errors of their library, which `judge` classifies, or a `SplatreelError`.
    """

    def read(self, name: str, begin: int, end: int) -> bytes:
        """Return the bytes from `begin` to `end` (exclusive) of a file, fewer at its end."""
        ...

    def write(self, name: str, data: bytes, headers: Headers) -> None:
        """Create or replace a file. Readers see the old content or the new content, never a part."""
        ...

    def sizes(self, prefix: str) -> dict[str, int]:
        """Return the sizes of at least all files whose name starts with `prefix`; none without the folder."""
        ...

    def remove(self, name: str) -> None:
        """Delete a file. A missing file is not an error."""
        ...


class Disk:
    """Folder on a local disk, created by the first write."""

    def __init__(self, path: Path, kind: Kind) -> None:
        self._path = path
        self._kind = kind

    def read(self, name: str, begin: int, end: int) -> bytes:
        """Return a part of a file. A pipe, a device or a folder is an error."""
        from splatreel.base.untrusted import open_regular  # it needs numpy, which `splatreel --help` does without

        with open_regular(self._path / name, self._kind) as file:
            file.seek(begin)
            return file.read(end - begin)

    def write(self, name: str, data: bytes, headers: Headers) -> None:
        """Create or replace a file."""
        path = self._path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        sweep(path.parent, path.name)
        with replacing(path) as temporary:
            temporary.write_bytes(data)

    def sizes(self, prefix: str) -> dict[str, int]:
        """Return the sizes of files by name."""
        return dict(self._walk())

    def remove(self, name: str) -> None:
        """Delete a file."""
        remove(self._path / name)

    def _walk(self) -> Iterator[tuple[str, int]]:
        for folder, folders, files in os.walk(self._path):
            folders[:] = [name for name in folders if not name.startswith(".")]
            for path in (Path(folder, name) for name in files):
                with contextlib.suppress(FileNotFoundError):  # deleted since
                    yield path.relative_to(self._path).as_posix(), path.stat().st_size


def is_plain(name: str) -> bool:
    """Return whether a name stays within a folder: no part is empty, hidden or leads upwards."""
    return _NAME.fullmatch(name) is not None


class Verdict(enum.Enum):
    """Meaning of an error."""

    MISSING = enum.auto()
    """There is no such file, folder or bucket."""
    REFUSED = enum.auto()
    """Credentials are missing, or do not allow the access."""
    LASTING = enum.auto()
    """Another attempt would fail too."""
    PASSING = enum.auto()
    """The server or the connection failed. Another attempt may succeed."""


_NO_CREDENTIALS = ("CredentialsError", "AuthenticationError", "AuthenticationException")
"""Ends of the names of errors about credentials. Each service has its own types."""
_PASSING_STATUS = (408, 425, 429)
"""HTTP status codes below 500 of servers that ask for another attempt."""
_PASSING_CODES = ("IncompleteBody", "RequestTimeout", "SlowDown", "OperationAborted", "BadDigest")
"""Errors of S3 with a status below 500 that ask for another attempt."""
_PASSING_NUMBERS = {
    getattr(errno, name, None)
    for name in (
        *("EIO", "EBUSY", "EAGAIN", "EINTR", "ESTALE", "EREMOTEIO", "EPIPE", "ETIMEDOUT", "ENETDOWN", "ENETUNREACH"),
        *("ENETRESET", "EHOSTDOWN", "EHOSTUNREACH", "ENOBUFS", "ECONNABORTED", "ECONNRESET", "ECONNREFUSED"),
    )
}
_LASTING = (
    *(NotADirectoryError, IsADirectoryError, FileExistsError, ssl.SSLCertVerificationError, InvalidURL),
    *(ValueError, TypeError, AttributeError, NotImplementedError, ImportError),
)


def judge(error: Exception) -> Verdict:
    """Return the meaning of an error of any library: urllib, aiohttp, botocore, and those of Google, Azure and SFTP."""
    chain, status = _causes(error), status_of(error)
    if isinstance(error, FileNotFoundError) or status in (404, 410):
        return Verdict.MISSING
    no_credentials = any(type(link).__name__.endswith(_NO_CREDENTIALS) for link in chain)
    if isinstance(error, PermissionError) or status in (401, 403) or no_credentials:
        return Verdict.REFUSED
    return Verdict.PASSING if _is_passing(chain, status) else Verdict.LASTING


def _is_passing(chain: list[BaseException], status: int | None) -> bool:
    if any(_code(link) in _PASSING_CODES for link in chain) or status in _PASSING_STATUS:
        return True
    if status is not None:
        return status >= 500 or status < 400
    for link in chain:
        if isinstance(link, _LASTING):
            return False
        if isinstance(link, TimeoutError | ConnectionError | ssl.SSLError):
            return True
        if isinstance(link, socket.gaierror):  # a wrong name, or no connection to the server of names
            return link.errno == socket.EAI_AGAIN
        if isinstance(link, OSError) and link.errno is not None:
            return link.errno in _PASSING_NUMBERS
    return True


def _causes(error: BaseException) -> list[BaseException]:
    """Return an error and its causes."""
    chain: list[BaseException] = []
    link: Any = error
    while isinstance(link, BaseException) and link not in chain:
        chain.append(link)
        reason = getattr(link, "reason", None)  # of urllib
        link = reason if isinstance(reason, BaseException) else link.__cause__
    return chain


def status_of(error: Exception) -> int | None:
    """Return the HTTP status that an error or one of its causes carries, if any."""
    return next((found for link in _causes(error) if (found := _status(link)) is not None), None)


def _status(error: BaseException) -> int | None:
    if type(error).__module__ == "aiohttp.http_exceptions":  # an invalid response, whose code 400 is aiohttp's own
        return None
    response = getattr(error, "response", None)
    if isinstance(response, dict):  # of botocore
        found = [response.get("ResponseMetadata", {}).get("HTTPStatusCode")]
    else:
        found = [getattr(error, name, None) for name in ("code", "status", "status_code")]
        found.append(getattr(response, "status_code", None))
    return next((value for value in found if isinstance(value, int) and 100 <= value < 600), None)


def _code(error: BaseException) -> str | None:
    """Return the code of an S3 error, if it is one."""
    response = getattr(error, "response", None)
    return response.get("Error", {}).get("Code") if isinstance(response, dict) else None
