"""Files of a web server. The server is untrusted: it may redirect, send slowly, or send more than it should."""

from __future__ import annotations

import base64
import contextlib
import re
import socket
import threading
import time
import urllib.error
import urllib.request
from http.client import HTTPConnection, HTTPResponse, HTTPSConnection
from typing import TYPE_CHECKING
from urllib.parse import unquote, urljoin, urlsplit

from splatreel.base.errors import UsageError
from splatreel.storage.transport import Headers

if TYPE_CHECKING:
    from splatreel.base.untrusted import Kind

TIMEOUT = 30.0
"""Seconds without data after which a server counts as unreachable."""
HEAD = 60.0
"""Maximum seconds until a response's header is complete."""
PATIENCE = 600.0
"""Maximum seconds for one file."""
_BLOCK = 1 << 20


class Web:
    """Folder on a web server. A query, such as a signature, and a user with a password are sent with each request."""

    def __init__(self, url: str, kind: Kind) -> None:
        split = urlsplit(url)
        user, _, host = split.netloc.rpartition("@")
        self._base = f"{split.scheme}://{host}{split.path.rstrip('/')}/"
        self._query = f"?{split.query}" if split.query else ""
        self._headers = {"Authorization": f"Basic {_encoded(user)}"} if user else {}
        self._opener = urllib.request.build_opener(_SameHost(split.scheme, host, kind), _Http(), _Https())

    def read(self, name: str, begin: int, end: int) -> bytes:
        """Return a part of a file, also from a server that ignores ranges."""
        headers = {"Range": f"bytes={begin}-{end - 1}"} if begin else {}
        url = urljoin(self._base, name) + self._query
        request = urllib.request.Request(url, headers=self._headers | headers)
        try:
            with self._opener.open(request, timeout=TIMEOUT) as response:
                skipped = begin if begin and response.status != 206 else 0
                if begin and not skipped:
                    _check_range(response, begin)
                return _read_with_deadline(response, skipped, end - begin)
        except urllib.error.HTTPError as error:
            if error.code == 416:  # the file ends before `begin`
                return b""
            raise

    def write(self, name: str, data: bytes, headers: Headers) -> None:
        """Refuse."""
        raise UsageError(
            f"{self._base}: web servers take no files. Give the address of the bucket, such as s3://BUCKET/REEL."
        )

    def sizes(self, prefix: str) -> dict[str, int]:
        """Refuse."""
        raise UsageError(
            f"{self._base}: web servers do not list their files. Give the address of the bucket, such as s3://BUCKET/CAPTURE, "
            "or copy the folder to this machine."
        )

    def remove(self, name: str) -> None:
        """Refuse."""
        self.write(name, b"", Headers())


def _encoded(user: str) -> str:
    return base64.b64encode(unquote(user).encode()).decode()


def _check_range(response: HTTPResponse, begin: int) -> None:
    found = re.match(r"bytes (\d+)-", response.headers.get("Content-Range", ""))
    if found is None or int(found[1]) != begin:
        raise ConnectionError("the server sent another part of the file")


def _read_with_deadline(response: HTTPResponse, skipped: int, size: int) -> bytes:
    """Read up to `size` bytes after `skipped` ones. Slow servers never exceed the socket timeout, so a deadline applies.

    Raises:
        ConnectionError: The connection was closed before the announced length.
        TimeoutError: The deadline has passed.
    """
    data, seen, announced = bytearray(), 0, response.length
    deadline = time.monotonic() + PATIENCE
    while seen < skipped + size:
        part = response.read1(min(skipped + size - seen, _BLOCK))
        if not part:
            break
        data += part[max(skipped - seen, 0) :]
        seen += len(part)
        if time.monotonic() > deadline:
            raise TimeoutError(f"{seen} bytes in {PATIENCE:.0f} s")
    if announced is not None and seen < min(announced, skipped + size):
        raise ConnectionError(f"the connection ended after {seen:,} of {announced:,} bytes")
    return bytes(data)


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

    def __init__(self, scheme: str, host: str, kind: Kind) -> None:
        self.scheme = scheme
        self.host = host
        self.kind = kind

    def redirect_request(self, req, fp, code, msg, headers, newurl):
        shown = req.full_url.partition("?")[0]  # without a signature
        if self.scheme == "https" and urlsplit(newurl).scheme != "https":
            raise self.kind(f"{shown}: redirects from HTTPS to {newurl:.200}, which is not followed.")
        if urlsplit(newurl).netloc != self.host:
            raise self.kind(f"{shown}: redirects to another host ({newurl:.200}), which is not followed.")
        return super().redirect_request(req, fp, code, msg, headers, newurl)
