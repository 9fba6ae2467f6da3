"""What the web server answers: below `/` the player's files, below `/reel/` those that the reel's manifest names, to be read only."""

from __future__ import annotations

import base64
import hashlib
import io
import os
import re
from collections.abc import AsyncIterator
from email.utils import formatdate, parsedate_to_datetime
from pathlib import Path
from typing import BinaryIO, NamedTuple

from anyio import CapacityLimiter, to_thread
from starlette.concurrency import run_in_threadpool
from starlette.middleware.cors import CORSMiddleware
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response, StreamingResponse
from starlette.types import ASGIApp, Receive, Scope, Send

from splatreel.errors import ReelError
from splatreel.play.allowed_hosts import AllowedHosts, host_name
from splatreel.play.player_page import STATIC, with_metadata
from splatreel.play.served_files import OpenFile, ReelFiles, open_file

_PAGE = "index.html"
_PLAYER_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".wasm": "application/wasm",
    ".txt": "text/plain; charset=utf-8",
}
_REEL_TYPES = {".json": "application/json", ".mp4": "audio/mp4", ".m4s": "audio/mp4", ".jpg": "image/jpeg"}
"""Whatever else a manifest names is bytes: nothing of a reel may run as a page or a script."""
_REEL_POLICY = "default-src 'none'"
_READ = ("GET", "HEAD")
_CHUNK = 1 << 16
"""Bytes that are held for each reader."""
_READERS = 4
"""Threads that read files for answers under way, so that new requests do not queue behind many of these."""


class Content(NamedTuple):
    """What is sent: its bytes, their number, type, entity tag, time of the last change (seconds since 1970),
    Content-Security-Policy, and how long browsers may keep it."""

    file: BinaryIO
    size: int
    type: str
    tag: str
    modified: float
    policy: str
    cache: str = "no-cache"


class WebApp:
    """The ASGI application. names: what it may be asked for as; cors: whether pages of other sites may read it."""

    def __init__(self, reel: ReelFiles, names: AllowedHosts, cors: bool = False) -> None:
        self._files = reel
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
        request = Request(scope)
        host = request.headers.get("Host", "")
        if host not in self._names:
            await self._refuse(421, _other_name(host))(scope, receive, send)
        else:
            await self._app(scope, receive, send)

    async def _respond(self, scope: Scope, receive: Receive, send: Send) -> None:
        request = Request(scope)
        bears = request.headers.get("Content-Length", "0") != "0" or "Transfer-Encoding" in request.headers
        closing = {"Connection": "close"} if bears else {}
        if request.method not in _READ:
            response: Response = self._refuse(405, "This server is read only.", Allow=", ".join(_READ), **closing)
        elif bears:
            response = self._refuse(413, "This server takes nothing: send requests without a body.", **closing)
        else:
            response = await run_in_threadpool(self._answer, request)
        await response(scope, receive, send)

    def _answer(self, request: Request) -> Response:
        try:
            content = self._find(request)
        except ReelError:
            return self._refuse(502, "This file cannot be fetched from where the reel lies.")
        return self._send(request, content) if content else self._refuse(404, "There is no such file here.")

    def _refuse(self, status: int, text: str, **headers: str) -> Response:
        return PlainTextResponse(f"{text}\n", status, {**self._headers, **headers})

    def _find(self, request: Request) -> Content | None:
        name = request.scope["path"].removeprefix("/")
        try:
            if name.startswith("reel/"):
                found = self._files.open(name.removeprefix("reel/"))
                kind = _REEL_TYPES.get(Path(name).suffix, "application/octet-stream")
                return _content(found, kind, _REEL_POLICY) if found else None
            name = name or _PAGE
            kind = _PLAYER_TYPES.get(Path(name).suffix)
            if kind is None or name not in os.listdir(STATIC):
                return None
            if name == _PAGE:
                return self._page(request)
            # A page starts several workers from one script.
            return _content(open_file(STATIC / name), kind, policy())._replace(cache="max-age=60")
        except OSError:
            return None

    def _page(self, request: Request) -> Content:
        """The player's page, with what the reel says of itself unless another one is asked for."""
        file = STATIC / _PAGE
        text, modified = file.read_text(encoding="utf-8"), file.stat().st_mtime
        if "src" not in request.query_params:
            said, written = self._files.presentation()
            secure = request.headers.get("X-Forwarded-Proto") == "https"
            address = f"http{'s' if secure else ''}://{request.headers['Host']}/"
            text, modified = with_metadata(text, said, address), max(modified, written)
        data = text.encode()
        tag = f'"{hashlib.sha256(data).hexdigest()[:32]}"'
        return Content(io.BytesIO(data), len(data), _PLAYER_TYPES[".html"], tag, modified, policy())

    def _send(self, request: Request, content: Content) -> Response:
        asked = request.headers
        headers = self._headers | {
            "ETag": content.tag,
            "Last-Modified": formatdate(content.modified, usegmt=True),
            "Accept-Ranges": "bytes",
            # A reel can be replaced or grow: ask before using a copy.
            "Cache-Control": content.cache,
            "Content-Security-Policy": content.policy,
        }
        if _unchanged(asked.get("If-None-Match"), asked.get("If-Modified-Since"), content):
            content.file.close()
            return Response(None, 304, headers)
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
    """Part of an open file, which it closes."""

    def __init__(self, file: BinaryIO, chunks: AsyncIterator[bytes], status: int, headers: dict[str, str]) -> None:
        super().__init__(chunks, status, headers)
        self._file = file

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        with self._file:
            await super().__call__(scope, receive, send)


async def _chunks(file: BinaryIO, start: int, end: int, reading: CapacityLimiter) -> AsyncIterator[bytes]:
    """Bytes start to end, fewer where the file became shorter: uvicorn then cuts the connection, which had been promised more."""
    file.seek(start)
    left = end - start
    while left > 0 and (chunk := await to_thread.run_sync(file.read, min(_CHUNK, left), limiter=reading)):
        left -= len(chunk)
        yield chunk


def policy() -> str:
    """The Content-Security-Policy of the player's files: that of docs/player.md, but reels may lie on any host (`?src=`)."""
    scripts = re.findall(r"<script[^>]*>([^<].*?)</script>", (STATIC / _PAGE).read_text(encoding="utf-8"), re.S)
    digests = (base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts)
    hashes = "".join(f" 'sha256-{digest}'" for digest in digests)
    return (
        f"default-src 'none'; script-src 'self'{hashes} 'wasm-unsafe-eval'; worker-src 'self'; "
        "connect-src 'self' http: https: blob:; img-src 'self' http: https: data: blob:; media-src blob:; "
        "base-uri 'none'; form-action 'none'"
    )


def parse_range(header: str | None, size: int) -> tuple[int, int] | tuple[()] | None:
    """(start, end) of a single byte range; () if it lies outside; None where the whole file should be sent."""
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


def _content(found: OpenFile, kind: str, policy: str) -> Content:
    return Content(found.file, found.size, kind, found.tag, found.modified, policy)


def _unchanged(tags: str | None, since: str | None, content: Content) -> bool:
    if tags is not None:
        return content.tag in [item.strip().removeprefix("W/") for item in tags.split(",")]
    try:
        return since is not None and int(content.modified) <= parsedate_to_datetime(since).timestamp()
    except (TypeError, ValueError, OverflowError):
        return False


def _other_name(header: str) -> str:
    name = host_name(header)
    if name is None:
        return "The request does not say which host it is for."
    return f"This server does not answer to the name {name}. If it should, start it with: --allow-host {name}"
