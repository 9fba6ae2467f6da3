"""Sources of a reel's bytes: a directory, a web server, or a bucket."""

from __future__ import annotations

import contextlib
import os
import socket
import stat
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from http.client import HTTPConnection, HTTPException, HTTPResponse, HTTPSConnection
from pathlib import Path
from typing import Protocol, overload
from urllib.parse import urljoin, urlsplit

from splatreel.base.errors import ReelError, StorageError, UsageError
from splatreel.storage.addresses import is_url, local_path, open_folder

TIMEOUT = 30.0
"""Seconds without data after which a server counts as unreachable."""
HEAD = 60.0
"""Maximum seconds until a response's header is complete."""
PATIENCE = 600.0
"""Maximum seconds for one file."""


class Source(Protocol):
    """Files of one reel."""

    def read(self, uri: str, limit: int) -> bytes:
        """Return the file at a checked relative URI. Raise `ReelError` if it is missing or longer than `limit` bytes."""
        ...

    def name(self, uri: str) -> str:
        """Return the name of a file for messages."""
        ...


def within_patience(source: Source) -> Callable[[str, int], bytes]:
    """Return `source.read` with a common deadline of `PATIENCE` for all files, against servers that send very slowly."""
    end = time.monotonic() + PATIENCE

    def read(uri: str, limit: int) -> bytes:
        if time.monotonic() > end:
            raise ReelError(
                f"{source.name(uri)}: was not requested, because earlier files took {PATIENCE:.0f} s. Try again."
            )
        return source.read(uri, limit)

    return read


def open_source(location: str | Path) -> Source:
    """Return the source of a reel at a directory, a manifest.json, or a URL of either: http(s), or a protocol of fsspec.

    Raises:
        ReelError: The address is invalid.
        MissingDependencyError: A required Python package is not installed.
    """
    text = str(location)
    if text.startswith(("http://", "https://")):
        try:
            return _Web(text)
        except ValueError as error:
            raise ReelError(f"{text}: is not an address ({error}). Correct it.") from error
    try:
        path = local_path(location)
        if path is None:
            return _Bucket(text.removesuffix("manifest.json"))
    except (UsageError, StorageError) as error:
        raise ReelError(str(error)) from error
    return _Directory(path.parent if path.name == "manifest.json" else path)


@overload
def find_reel(path: Path) -> Path: ...


@overload
def find_reel(path: str | Path) -> str | Path: ...


def find_reel(path: str | Path) -> str | Path:
    """Return the folder of a reel, also for the output folder of `reconstruct` or `demo`. A URL is returned as it is."""
    if isinstance(path, str) and is_url(path):
        return path
    folder = Path(path)
    inside = folder / "reel"
    return inside if not (folder / "manifest.json").exists() and (inside / "manifest.json").exists() else folder


class _Directory:
    def __init__(self, root: Path) -> None:
        self.root = root

    def name(self, uri: str) -> str:
        return str(self.root / uri)

    def read(self, uri: str, limit: int) -> bytes:
        try:
            with open(self.root / uri, "rb", opener=_without_waiting) as file:
                if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                    raise ReelError(f"{self.name(uri)}: is not a file. Is this a complete reel?")
                return _bounded(file.read(limit + 1), limit, self.name(uri))
        except OSError as error:
            raise ReelError(f"{self.name(uri)}: cannot be read ({error.strerror}). Is this a complete reel?") from error


def _without_waiting(path: str, flags: int) -> int:
    """Open a pipe without waiting for a writer."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


class _Web:
    def __init__(self, url: str) -> None:
        split = urlsplit(url)
        path = split.path.removesuffix("manifest.json")
        self.base = f"{split.scheme}://{split.netloc}{path if path.endswith('/') else path + '/'}"
        self.opener = urllib.request.build_opener(_SameHost(split.scheme, split.netloc), _Http(), _Https())

    def name(self, uri: str) -> str:
        return urljoin(self.base, uri)

    def read(self, uri: str, limit: int) -> bytes:
        url = self.name(uri)
        try:
            with self.opener.open(url, timeout=TIMEOUT) as response:
                return _bounded(_read_with_deadline(response, limit + 1), limit, url)
        except (urllib.error.URLError, HTTPException, OSError, ValueError) as error:
            raise ReelError(f"{url}: cannot be fetched ({error}). Check the address and the connection.") from error


class _Bucket:
    """Folder at an address that fsspec supports."""

    def __init__(self, url: str) -> None:
        self.folder = open_folder(url)

    def name(self, uri: str) -> str:
        return self.folder.address(uri)

    def read(self, uri: str, limit: int) -> bytes:
        try:
            data = self.folder.read(uri, limit + 1)
        except StorageError as error:
            raise ReelError(f"{error} Check the address and the connection.") from error
        if data is None:
            raise ReelError(f"{self.name(uri)}: cannot be fetched (it is not there). Is this a complete reel?")
        return _bounded(data, limit, self.name(uri))


class _HeaderDeadline(HTTPConnection):
    """HTTP connection that is closed if the response's header takes too long. Slow servers never exceed the socket timeout."""

    def connect(self) -> None:
        super().connect()
        self._late = threading.Event()
        self._end = threading.Timer(HEAD, self._hang_up, [self.sock, self._late])
        self._end.daemon = True
        self._end.start()

    def getresponse(self) -> HTTPResponse:
        try:
            response = super().getresponse()
        finally:
            self._end.cancel()
        if self._late.is_set():
            raise TimeoutError(f"no answer in {HEAD:.0f} s")
        return response

    @staticmethod
    def _hang_up(connection: socket.socket, late: threading.Event) -> None:
        late.set()
        with contextlib.suppress(OSError):
            connection.shutdown(socket.SHUT_RDWR)


class _HeaderDeadlineTls(_HeaderDeadline, HTTPSConnection):
    pass


class _Http(urllib.request.HTTPHandler):
    def http_open(self, req: urllib.request.Request) -> HTTPResponse:
        return self.do_open(_HeaderDeadline, req)


class _Https(urllib.request.HTTPSHandler):
    def https_open(self, req: urllib.request.Request) -> HTTPResponse:
        return self.do_open(_HeaderDeadlineTls, req)


class _SameHost(urllib.request.HTTPRedirectHandler):
    """Handler that follows redirects within the requested host only, and never from HTTPS to HTTP."""

    def __init__(self, scheme: str, host: str) -> None:
        self.scheme = scheme
        self.host = host

    def redirect_request(self, req, fp, code, msg, headers, newurl):
        if self.scheme == "https" and urlsplit(newurl).scheme != "https":
            raise ReelError(f"{req.full_url}: redirects from HTTPS to {newurl:.200}, which is not followed.")
        if urlsplit(newurl).netloc != self.host:
            raise ReelError(f"{req.full_url}: redirects to another host ({newurl:.200}), which is not followed.")
        return super().redirect_request(req, fp, code, msg, headers, newurl)


def _read_with_deadline(response: HTTPResponse, size: int) -> bytes:
    """Read up to `size` bytes. Slow servers never exceed the socket timeout, so a deadline applies."""
    data = bytearray()
    deadline = time.monotonic() + PATIENCE
    while len(data) < size:
        part = response.read1(min(size - len(data), 1 << 20))
        if not part:
            break
        data += part
        if time.monotonic() > deadline:
            raise TimeoutError(f"{len(data)} bytes in {PATIENCE:.0f} s")
    return bytes(data)


def _bounded(data: bytes, limit: int, name: str) -> bytes:
    if len(data) > limit:
        raise ReelError(f"{name}: is longer than the {limit} bytes it should have.")
    return data
