"""Access to files of a folder: on a disk, or at any address that fsspec supports, such as S3, Google and Azure buckets, and SFTP."""

from __future__ import annotations

import contextlib
import enum
import errno
import os
import posixpath
import re
import secrets
import socket
import ssl
from collections.abc import Iterator
from http.client import InvalidURL
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from splatreel.base.atomic import remove, replacing, sweep
from splatreel.base.command_line import install_command
from splatreel.base.errors import MissingDependencyError, UsageError

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
    response = getattr(error, "response", None)
    return response.get("Error", {}).get("Code") if isinstance(response, dict) else None


_S3, _GOOGLE, _AZURE = ("s3", "s3a"), ("gs", "gcs"), ("az", "abfs", "abfss")
_WHOLE = (*_S3, *_GOOGLE, *_AZURE, "oss", "obs", "memory")
"""Protocols whose files appear only when complete. For other protocols a file is written under a temporary name and moved."""
_BY_PREFIX = (*_S3, *_GOOGLE)
"""Protocols that can list files by a prefix of their names."""
_PACKAGES = {**dict.fromkeys(_S3, "s3fs"), **dict.fromkeys(_GOOGLE, "gcsfs"), **dict.fromkeys(_AZURE, "adlfs")}
"""Python package that fsspec needs for each common protocol."""
_HELP = "(docs/publishing.md)."
CREDENTIALS = {
    **dict.fromkeys(_S3, f"Give credentials: `aws configure`, or AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY {_HELP}"),
    **dict.fromkeys(_GOOGLE, f"Give credentials: `gcloud auth application-default login` {_HELP}"),
    **dict.fromkeys(_AZURE, f"Give credentials: AZURE_STORAGE_ACCOUNT_NAME and AZURE_STORAGE_ACCOUNT_KEY {_HELP}"),
    **dict.fromkeys(
        ("http", "https"),
        f"Let the public read it, or give the bucket's own address with credentials, such as s3://BUCKET/REEL {_HELP} Some hosts "
        "answer so for missing files.",
    ),
    "": f"Give credentials that may access it {_HELP}",
}
"""Remedies for each protocol where access is refused."""


class Bucket:
    """Folder at a URL such as `s3://bucket/reels/one`.

    Args:
        url: Address of the folder.
        shown: The address for messages.

    Raises:
        UsageError: The address is invalid.
        MissingDependencyError: A required Python package is not installed.
        Exception: The service cannot be reached.
    """

    def __init__(self, url: str, shown: str) -> None:
        self._protocol = url.partition("://")[0].lower()
        self._files, root = _open(url, shown, self._protocol)
        self._root = root.rstrip("/")
        if not self._root.strip("/"):
            raise UsageError(
                f"{shown}: names no folder. Write the bucket as well, such as {self._protocol}://BUCKET/REEL."
            )

    def read(self, name: str, begin: int, end: int) -> bytes:
        """Return a part of a file, also from a server that ignores ranges."""
        try:
            data = self._files.cat_file(f"{self._root}/{name}", start=begin, end=end)
        except Exception as error:
            if status_of(error) != 416:
                raise
            return b""  # the file ends before `begin`
        return data if len(data) <= end - begin else data[begin:end]

    def write(self, name: str, data: bytes, headers: Headers) -> None:
        """Create or replace a file."""
        path = f"{self._root}/{name}"
        if self._protocol in _WHOLE:
            self._files.pipe_file(path, data, **header_arguments(self._protocol, headers))
        else:
            self._move_into_place(path, data)

    def sizes(self, prefix: str) -> dict[str, int]:
        """Return the sizes of files by name."""
        folder, last = posixpath.split(prefix)
        by_prefix = {"prefix": last} if last and self._protocol in _BY_PREFIX else {}
        try:
            self._files.invalidate_cache()
            found = self._files.find(f"{self._root}/{folder}".rstrip("/"), detail=True, **by_prefix)
        except FileNotFoundError:
            return {}
        return {str(path).removeprefix(f"{self._root}/"): int(entry["size"]) for path, entry in found.items()}

    def remove(self, name: str) -> None:
        """Delete a file."""
        with contextlib.suppress(FileNotFoundError):
            self._files.rm_file(f"{self._root}/{name}")

    def _move_into_place(self, path: str, data: bytes) -> None:
        folder, name = posixpath.split(path)
        temporary = f"{folder}/.{name}.{secrets.token_hex(8)}.tmp"
        self._files.makedirs(folder, exist_ok=True)
        try:
            self._files.pipe_file(temporary, data)
            self._files.mv(temporary, path)
        except BaseException:
            with contextlib.suppress(Exception):
                self._files.rm_file(temporary)
            raise


def _open(url: str, shown: str, protocol: str) -> tuple[Any, str]:
    """Return fsspec's file system and the path within it."""
    package = f" {_PACKAGES[protocol]}" if protocol in _PACKAGES else ""
    try:
        from fsspec.core import url_to_fs
    except ModuleNotFoundError as error:
        raise MissingDependencyError(
            f"{shown}: addresses of buckets need fsspec. Run\n  {install_command('cloud')}{package}"
        ) from error
    try:
        return url_to_fs(url, use_listings_cache=False)
    except ImportError as error:
        advice = f"Run\n  pip install{package}" if package else f"{error}"
        raise MissingDependencyError(f"{shown}: a Python package for {protocol}:// is missing. {advice}") from error
    except ValueError as error:
        raise UsageError(f"{shown}: is not the address of a folder ({error}). Correct it.") from error


def header_arguments(protocol: str, headers: Headers) -> dict[str, Any]:
    """Return the arguments by which `pipe_file` sets headers. Hosts of other protocols choose headers themselves."""
    if protocol in _S3:
        return {"ContentType": headers.type, "CacheControl": headers.caching}
    if protocol in _GOOGLE:
        return {"content_type": headers.type, "fixed_key_metadata": {"cache_control": headers.caching}}
    return {}
