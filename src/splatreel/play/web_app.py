"""ASGI application: the player's files below `/`, and the files that the reel's manifest names below `/reel/`.

Starlette's `FileResponse` would open a path again, cannot send bytes from memory, and rejects invalid ranges, which this application
answers with the whole file. Ranges are therefore parsed here.
"""

from __future__ import annotations

import base64
import hashlib
import io
import ipaddress
import os
import re
import socket
import time
from collections.abc import AsyncIterator, Iterable, Mapping
from email.utils import formatdate
from pathlib import Path
from types import MappingProxyType
from typing import BinaryIO, NamedTuple, Protocol

from anyio import CapacityLimiter, to_thread
from starlette.concurrency import run_in_threadpool
from starlette.middleware.cors import CORSMiddleware
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response, StreamingResponse
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Receive, Scope, Send

from splatreel.base.errors import ReelError, UsageError
from splatreel.play.player_page import STATIC, with_metadata
from splatreel.play.served_files import OpenFile, ReelFiles, open_file

_HOST = re.compile(r"(?:([A-Za-z0-9._-]{1,253})|\[([0-9A-Fa-f:.]{2,45})\])(?::\d{1,5})?")


class AllowedHosts:
    """Permitted values of a Host header.

    A server on a loopback address answers to localhost and loopback addresses. Other servers also answer to any IP address, to this
    machine's name and to the host name they were started with.
    """

    def __init__(self, bound: str, given: str, allowed: Iterable[str] = ()) -> None:
        """Collect the permitted names.

        Args:
            bound: IP address that the server listens on.
            given: The same host as the user wrote it.
            allowed: Further names, such as that of a proxy.

        Raises:
            UsageError: One of `allowed` is not a host name.
        """
        self._loopback = ipaddress.ip_address(bound.split("%")[0]).is_loopback
        self._names = {"localhost", *map(_checked, allowed)}
        if not self._loopback:
            machine = socket.gethostname().lower()
            self._names |= {given.lower(), machine, f"{machine}.local"}

    def __contains__(self, header: object) -> bool:
        name = _host_name(header) if isinstance(header, str) else None
        if name is None:
            return False
        try:
            return ipaddress.ip_address(name).is_loopback or not self._loopback or name in self._names
        except ValueError:
            return name in self._names


def _host_name(header: str) -> str | None:
    """Return the name or address in a Host header, without port and brackets; None for an invalid header."""
    match = _HOST.fullmatch(header)
    return (match[1] or match[2]).lower().removesuffix(".") if match else None


def _checked(name: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9._-]{1,253}|[0-9A-Fa-f:.]{2,45}", name):
        raise UsageError(
            f"{name!r:.100} is not the name of a host. Give it without scheme, port and path: reels.example"
        )
    return name.lower().removesuffix(".")


_PAGE = "index.html"
_PLAYER_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".wasm": "application/wasm",
    ".txt": "text/plain; charset=utf-8",
}
_REEL_TYPES = {".json": "application/json", ".mp4": "audio/mp4", ".m4s": "audio/mp4", ".jpg": "image/jpeg"}
"""Content types of a reel's files. All others are sent as bytes, so that no file of a reel runs as a page or a script."""
_REEL_POLICY = "default-src 'none'"
_CONDITIONS = StaticFiles(check_dir=False)
"""Evaluates `If-None-Match` and `If-Modified-Since`."""
_READ = ("GET", "HEAD")
_CHUNK = 1 << 16
"""Bytes in memory per response."""
_READERS = 4
"""Threads that read files for running responses, so that new requests do not queue behind them."""


class Content(NamedTuple):
    """A file to send."""

    file: BinaryIO
    size: int
    type: str
    tag: str
    """Entity tag, with its quotes."""
    modified: float
    """Time of the last change, in seconds since 1970."""
    policy: str
    """Content-Security-Policy."""
    cache: str = "no-cache"
    """Cache-Control."""


class ServedPage(Protocol):
    """Further page of the server. `policy` is its Content-Security-Policy."""

    policy: str

    def read(self) -> str:
        """Return the page as HTML. It may raise `ReelError`."""
        ...


class WebApp:
    """The ASGI application."""

    def __init__(
        self,
        reel: ReelFiles,
        names: AllowedHosts,
        cors: bool = False,
        pages: Mapping[str, ServedPage] = MappingProxyType({}),
        reels: Mapping[str, ReelFiles] = MappingProxyType({}),
    ) -> None:
        """Serve a reel.

        Args:
            reel: Files of the reel.
            names: Permitted values of the Host header.
            cors: Whether pages of other sites may read the reel.
            pages: Further pages by name, such as report.html.
            reels: Further reels by the name of their folder, such as sample.
        """
        self._files = reel
        self._reels = {"reel": reel, **reels}
        self._pages = pages
        self._names = names
        self._headers = {
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",
            "Cross-Origin-Resource-Policy": "cross-origin" if cors else "same-origin",
        }
        self._reading = CapacityLimiter(_READERS)
        self._app: ASGIApp = self._respond
        if cors:
            shown = ("Content-Length", "Content-Range", "Accept-Ranges", "ETag")
            allowed = ("Range", "If-Range", "If-None-Match", "If-Modified-Since")
            self._app = CORSMiddleware(self._app, ("*",), _READ, allowed, expose_headers=shown)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request."""
        request = Request(scope)
        host = request.headers.get("Host", "")
        if host not in self._names:
            await self._refuse(421, _host_refusal(host))(scope, receive, send)
        else:
            await self._app(scope, receive, send)

    async def _respond(self, scope: Scope, receive: Receive, send: Send) -> None:
        request = Request(scope)
        has_body = request.headers.get("Content-Length", "0") != "0" or "Transfer-Encoding" in request.headers
        closing = {"Connection": "close"} if has_body else {}
        if request.method not in _READ:
            response: Response = self._refuse(405, "This server is read only.", Allow=", ".join(_READ), **closing)
        elif has_body:
            response = self._refuse(413, "This server accepts no request body.", **closing)
        else:
            response = await run_in_threadpool(self._answer, request)
        await response(scope, receive, send)

    def _answer(self, request: Request) -> Response:
        try:
            content = self._find(request)
        except ReelError:
            return self._refuse(502, "The remote host of the reel does not deliver this file.")
        return self._send(request, content) if content else self._refuse(404, "There is no such file.")

    def _refuse(self, status: int, text: str, **headers: str) -> Response:
        return PlainTextResponse(f"{text}\n", status, {**self._headers, **headers})

    def _find(self, request: Request) -> Content | None:
        name = request.scope["path"].removeprefix("/")
        try:
            folder, _, file = name.partition("/")
            if file and folder in self._reels:
                found = self._reels[folder].open(file)
                kind = _REEL_TYPES.get(Path(name).suffix, "application/octet-stream")
                return _content(found, kind, _REEL_POLICY) if found else None
            if name in self._pages:
                return _made(self._pages[name].read(), time.time(), self._pages[name].policy)
            name = name or _PAGE
            kind = _PLAYER_TYPES.get(Path(name).suffix)
            if kind is None or name not in os.listdir(STATIC):
                return None
            if name == _PAGE:
                return self._page(request)
            # Several workers start from one script.
            return _content(open_file(STATIC / name), kind, _policy_for(request))._replace(cache="max-age=60")
        except OSError:
            return None

    def _page(self, request: Request) -> Content:
        """Return the player's page, with the metadata of the reel unless the query names another reel."""
        file = STATIC / _PAGE
        text, modified = file.read_text(encoding="utf-8"), file.stat().st_mtime
        if "src" not in request.query_params:
            presentation, written = self._files.presentation()
            secure = request.headers.get("X-Forwarded-Proto") == "https"
            address = f"http{'s' if secure else ''}://{request.headers['Host']}/"
            text, modified = with_metadata(text, presentation, address), max(modified, written)
        return _made(text, modified, _policy_for(request))

    def _send(self, request: Request, content: Content) -> Response:
        asked = request.headers
        headers = self._headers | {
            "ETag": content.tag,
            "Last-Modified": formatdate(content.modified, usegmt=True),
            "Accept-Ranges": "bytes",
            "Cache-Control": content.cache,
            "Content-Security-Policy": content.policy,
        }
        not_modified = Response(None, 304, headers)
        # Dates must be the same: if the clock was set back, a newer file has an earlier date.
        same_date = "If-None-Match" in asked or asked.get("If-Modified-Since") == headers["Last-Modified"]
        if same_date and _CONDITIONS.is_not_modified(not_modified.headers, asked):
            content.file.close()
            return not_modified
        whole = asked.get("If-Range", content.tag) != content.tag
        span = None if whole else parse_range(asked.get("Range"), content.size)
        if span == ():
            content.file.close()
            return Response(None, 416, headers | {"Content-Range": f"bytes */{content.size}"})
        start, end = span or (0, content.size)
        if span:
            headers["Content-Range"] = f"bytes {start}-{end - 1}/{content.size}"
        headers |= {"Content-Type": content.type, "Content-Length": str(end - start)}
        if request.method == "HEAD":
            content.file.close()
            return Response(None, 206 if span else 200, headers)
        chunks = _chunks(content.file, start, end, self._reading)
        return _FileResponse(content.file, chunks, 206 if span else 200, headers)


class _FileResponse(StreamingResponse):
    """Response with a part of an open file, which it closes."""

    def __init__(self, file: BinaryIO, chunks: AsyncIterator[bytes], status: int, headers: dict[str, str]) -> None:
        super().__init__(chunks, status, headers)
        self._file = file

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        with self._file:
            await super().__call__(scope, receive, send)


async def _chunks(file: BinaryIO, start: int, end: int, reading: CapacityLimiter) -> AsyncIterator[bytes]:
    """Read bytes start to end. If the file became shorter, uvicorn closes the connection, since the content is incomplete."""
    file.seek(start)
    left = end - start
    while left > 0 and (chunk := await to_thread.run_sync(file.read, min(_CHUNK, left), limiter=reading)):
        left -= len(chunk)
        yield chunk


def policy(reel: str = "") -> str:
    """Return the Content-Security-Policy of the player's files: that of docs/player.md, with reels on any host.

    Args:
        reel: Address of the reel, as in `?src=`. Only its host, and the server itself, may send images.
    """
    scripts = re.findall(r"<script[^>]*>([^<].*?)</script>", (STATIC / _PAGE).read_text(encoding="utf-8"), re.S)
    digests = (base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts)
    hashes = "".join(f" 'sha256-{digest}'" for digest in digests)
    return (
        f"default-src 'none'; script-src 'self'{hashes} 'wasm-unsafe-eval'; worker-src 'self'; "
        f"connect-src 'self' http: https: blob:; img-src 'self'{_other_host(reel)} data: blob:; media-src blob:; "
        "base-uri 'none'; form-action 'none'"
    )


def _policy_for(request: Request) -> str:
    return policy(request.query_params.get("src", ""))


def _other_host(address: str) -> str:
    """Return the host of an address as a source of a policy, after a space; "" if the address names none."""
    match = re.match(r"(https?:)?//([a-z0-9.-]+(:\d{1,5})?)(?=[/?#]|$)", address, re.I)
    return f" {match[0] if match[1] else match[2]}" if match else ""


def parse_range(header: str | None, size: int) -> tuple[int, int] | tuple[()] | None:
    """Return (start, end) of a single byte range; () if it lies outside the file; None to send the whole file."""
    match = re.fullmatch(r"bytes=(\d{0,18})-(\d{0,18})", header.strip()) if header else None
    if match is None or match.group(1) == match.group(2) == "":
        return None
    if match.group(1) == "":
        start, end = max(size - int(match.group(2)), 0), size
    else:
        start = int(match.group(1))
        end = min(int(match.group(2)) + 1, size) if match.group(2) else size
        if match.group(2) and int(match.group(2)) < start:
            return None
    return (start, end) if start < end else ()


def _made(text: str, modified: float, policy: str) -> Content:
    """Return a page that is made on request."""
    data = text.encode()
    tag = f'"{hashlib.sha256(data).hexdigest()[:32]}"'
    return Content(io.BytesIO(data), len(data), _PLAYER_TYPES[".html"], tag, modified, policy)


def _content(found: OpenFile, kind: str, policy: str) -> Content:
    return Content(found.file, found.size, kind, found.tag, found.modified, policy)


def _host_refusal(header: str) -> str:
    name = _host_name(header)
    if name is None:
        return "The request has no valid Host header."
    return f"This server does not answer to the name {name}. If it should, start it with: --allow-host {name}"
