"""Where the bytes of a reel come from: a directory or a web server."""

from __future__ import annotations

import time
import urllib.error
import urllib.request
from http.client import HTTPException, HTTPResponse
from pathlib import Path
from typing import Protocol
from urllib.parse import urljoin, urlsplit

from splatreel.errors import ReelError

TIMEOUT = 30.0
"""Seconds without an answer after which a server counts as gone."""
PATIENCE = 600.0
"""Seconds that one file may take in all."""


class Source(Protocol):
    """Gives the files of one reel."""

    def read(self, uri: str, limit: int) -> bytes:
        """The file at a checked relative uri. Raises `ReelError` if it is missing or longer than `limit` bytes."""
        ...

    def name(self, uri: str) -> str:
        """What to call that file in messages."""
        ...


def open_source(location: str | Path) -> Source:
    """The source of a reel at a directory, a path to its manifest.json, or an http(s) URL of either."""
    text = str(location)
    if text.startswith(("http://", "https://")):
        return _Web(text)
    path = Path(location)
    return _Directory(path.parent if path.name == "manifest.json" else path)


class _Directory:
    def __init__(self, root: Path) -> None:
        self.root = root

    def name(self, uri: str) -> str:
        return str(self.root / uri)

    def read(self, uri: str, limit: int) -> bytes:
        try:
            with open(self.root / uri, "rb") as file:
                return _bounded(file.read(limit + 1), limit, self.name(uri))
        except OSError as error:
            raise ReelError(
                f"{self.name(uri)}: cannot be read ({error.strerror}). Is this a reel, and is it whole?"
            ) from error


class _Web:
    def __init__(self, url: str) -> None:
        split = urlsplit(url)
        path = split.path.removesuffix("manifest.json")
        self.base = f"{split.scheme}://{split.netloc}{path if path.endswith('/') else path + '/'}"
        self.opener = urllib.request.build_opener(_SameHost(split.netloc))

    def name(self, uri: str) -> str:
        return urljoin(self.base, uri)

    def read(self, uri: str, limit: int) -> bytes:
        url = self.name(uri)
        try:
            with self.opener.open(url, timeout=TIMEOUT) as response:
                return _bounded(_read_slowly(response, limit + 1), limit, url)
        except (urllib.error.URLError, HTTPException, OSError, ValueError) as error:
            raise ReelError(f"{url}: cannot be fetched ({error}). Check the address and the connection.") from error


class _SameHost(urllib.request.HTTPRedirectHandler):
    """Follows redirects within the host that was asked, and no others."""

    def __init__(self, host: str) -> None:
        self.host = host

    def redirect_request(self, req, fp, code, msg, headers, newurl):
        if urlsplit(newurl).netloc != self.host:
            raise ReelError(f"{req.full_url}: redirects to another host ({newurl:.200}), which is not followed.")
        return super().redirect_request(req, fp, code, msg, headers, newurl)


def _read_slowly(response: HTTPResponse, size: int) -> bytes:
    """Up to `size` bytes; a server that trickles is given up, since it would pass every single timeout."""
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
