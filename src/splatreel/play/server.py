"""Serves the web player and one reel over HTTP: read-only, from this machine only unless asked otherwise."""

from __future__ import annotations

import hashlib
import io
import os
import re
import socket
import threading
import webbrowser
from email.utils import formatdate, parsedate_to_datetime
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, NamedTuple, cast
from urllib.parse import parse_qs, unquote, urlsplit

from splatreel.codec.manifest import parse_manifest
from splatreel.errors import ReelError, UsageError
from splatreel.play.page import introduced

STATIC = Path(__file__).parent / "static"
"""The built web player, which `/` maps to; `/reel/` maps to the reel."""

_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".json": "application/json",
    ".wasm": "application/wasm",
    ".txt": "text/plain; charset=utf-8",
    ".safetensors": "application/octet-stream",
    ".mp4": "audio/mp4",
    ".m4s": "audio/mp4",
    ".jpg": "image/jpeg",
}
"""What is served at all: a file of another kind that happens to lie in the folder is not."""

_HOST = re.compile(r"[A-Za-z0-9._-]{1,253}(:\d{1,5})?|\[[0-9A-Fa-f:.]{2,45}\](:\d{1,5})?")
_CHUNK = 1 << 18
_IDLE_SECONDS = 30
_POLL_SECONDS = 0.05
"""How soon `close` is noticed."""


class Server:
    """An HTTP server of the player and a reel, on a thread of its own. Also a context manager: `with serve(path) as server:`."""

    def __init__(self, reel_path: str | Path, host: str = "127.0.0.1", port: int = 0) -> None:
        reel = Path(reel_path).resolve()
        if not (reel / "manifest.json").is_file():
            raise ReelError(
                f"{reel_path} is not a reel: it has no manifest.json. Give the directory that `encode` wrote."
            )
        try:
            self._http = _HTTPServer((host, port), _Handler)
        except (OSError, OverflowError) as error:
            reason = error.strerror if isinstance(error, OSError) else error
            raise UsageError(f"Cannot listen on {host}:{port} ({reason}). Choose another host or port.") from error
        self._http.roots = {"/reel/": reel, "/": STATIC.resolve()}
        self._thread = threading.Thread(
            target=self._http.serve_forever, args=(_POLL_SECONDS,), name="splatreel-server", daemon=True
        )
        self._started = False

    @property
    def url(self) -> str:
        """Address of the player."""
        host, port = self._http.server_address[:2]
        host = host.decode() if isinstance(host, bytes | bytearray) else host
        if host in ("0.0.0.0", "::"):
            host = "localhost"
        return f"http://[{host}]:{port}/" if ":" in host else f"http://{host}:{port}/"

    def start(self) -> Server:
        """Begin to answer; returns at once."""
        if not self._started:
            self._started = True
            self._thread.start()
        return self

    def wait(self) -> None:
        """Block until `close` is called by another thread, or Ctrl-C."""
        while self._thread.is_alive():
            self._thread.join(0.5)

    def close(self) -> None:
        """Stop answering and free the port."""
        if self._started:
            self._http.shutdown()
            self._thread.join()
        self._http.server_close()

    def __enter__(self) -> Server:
        return self.start()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def serve(reel_path: str | Path, host: str = "127.0.0.1", port: int = 8000, open_browser: bool = False) -> Server:
    """Start serving a reel directory and the player; port 0 takes any free one.

    Returns the running server: `.url` opens the player, `.wait()` blocks, `.close()` ends it.
    Raises `ReelError` if reel_path holds no reel, `UsageError` if the address cannot be used.
    """
    server = Server(reel_path, host, port).start()
    if open_browser:
        webbrowser.open(server.url)
    return server


class _HTTPServer(ThreadingHTTPServer):
    daemon_threads = True
    request_queue_size = 128
    roots: dict[str, Path]

    def __init__(self, address: tuple[str, int], handler: type[BaseHTTPRequestHandler]) -> None:
        if ":" in address[0]:
            self.address_family = socket.AF_INET6
        super().__init__(address, handler)

    def handle_error(self, request: object, client_address: object) -> None:
        """A player that goes away in the middle of an answer is no news."""


class Content(NamedTuple):
    """What is sent: its type, bytes, entity tag and time of the last change, seconds since 1970."""

    type: str
    size: int
    tag: str
    modified: float


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server_version = "splatreel"
    sys_version = ""
    timeout = _IDLE_SECONDS

    def do_GET(self) -> None:
        self._answer(body=True)

    def do_HEAD(self) -> None:
        self._answer(body=False)

    def do_OPTIONS(self) -> None:
        self.send_response(HTTPStatus.NO_CONTENT)
        self._send_cors()
        self.send_header("Content-Length", "0")
        self.end_headers()

    def log_message(self, format: str, *args: object) -> None:
        """Quiet: the terminal belongs to the person who started the server."""

    def _answer(self, body: bool) -> None:
        path = self._find()
        if path is None:
            self._refuse(HTTPStatus.NOT_FOUND, body)
            return
        try:
            file = path.open("rb")
        except OSError:
            self._refuse(HTTPStatus.NOT_FOUND, body)
            return
        with file:
            if path == STATIC.resolve() / "index.html":
                self._send_page(file, body)
                return
            status = os.fstat(file.fileno())
            tag = f'"{status.st_mtime_ns:x}-{status.st_size:x}"'
            self._send(file, Content(_TYPES[path.suffix], status.st_size, tag, status.st_mtime), body)

    def _send_page(self, file: BinaryIO, body: bool) -> None:
        """The player's page, with what the reel says of itself unless another one is asked for."""
        text, modified = file.read().decode(), os.fstat(file.fileno()).st_mtime
        manifest = cast(_HTTPServer, self.server).roots["/reel/"] / "manifest.json"
        try:
            if "src" not in parse_qs(urlsplit(self.path).query):
                text = introduced(text, parse_manifest(manifest.read_bytes(), "").presentation, self._address())
                modified = max(modified, manifest.stat().st_mtime)
        except (OSError, ValueError, ReelError):
            pass  # the player says what is wrong with the reel
        data = text.encode()
        tag = f'"{hashlib.sha256(data).hexdigest()[:32]}"'
        self._send(io.BytesIO(data), Content(_TYPES[".html"], len(data), tag, modified), body)

    def _address(self) -> str | None:
        """The root of this server as whoever asks calls it."""
        host = self.headers.get("Host", "")
        secure = self.headers.get("X-Forwarded-Proto") == "https"
        return f"http{'s' if secure else ''}://{host}/" if _HOST.fullmatch(host) else None

    def _find(self) -> Path | None:
        """The file a request names, if it lies inside what is served, links resolved."""
        try:
            name = unquote(urlsplit(self.path).path, errors="strict")
        except (UnicodeDecodeError, ValueError):
            return None
        if "\0" in name or "\\" in name or not name.startswith("/"):
            return None
        prefix = "/reel/" if name.startswith("/reel/") else "/"
        root = cast(_HTTPServer, self.server).roots[prefix]
        relative = name[len(prefix) :] or ("index.html" if prefix == "/" else "")
        if any(part in ("", ".", "..") or part.startswith(".") for part in relative.split("/")):
            return None
        try:
            path = (root / relative).resolve()
            inside = path.is_relative_to(root) and path.suffix in _TYPES and path.is_file()
        except (OSError, RuntimeError):  # a name too long for the file system, a loop of links
            return None
        return path if inside else None

    def _send(self, file: BinaryIO, content: Content, body: bool) -> None:
        size, tag, modified = content.size, content.tag, content.modified
        if self._unchanged(tag, modified):
            self.send_response(HTTPStatus.NOT_MODIFIED)
            self._send_common(tag, modified)
            self.end_headers()
            return
        span = _parse_range(self.headers.get("Range"), size) if self.headers.get("If-Range", tag) == tag else None
        if span == ():
            self.send_response(HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE)
            self.send_header("Content-Range", f"bytes */{size}")
            self.send_header("Content-Length", "0")
            self._send_common(tag, modified)
            self.end_headers()
            return
        start, end = span or (0, size)
        self.send_response(HTTPStatus.PARTIAL_CONTENT if span else HTTPStatus.OK)
        if span:
            self.send_header("Content-Range", f"bytes {start}-{end - 1}/{size}")
        self.send_header("Content-Type", content.type)
        self.send_header("Content-Length", str(end - start))
        self._send_common(tag, modified)
        self.end_headers()
        if body:
            self._copy(file, start, end)

    def _copy(self, file: BinaryIO, start: int, end: int) -> None:
        file.seek(start)
        left = end - start
        while left > 0:
            chunk = file.read(min(_CHUNK, left))
            if not chunk:  # The file became shorter: the promised length cannot be kept any more.
                self.close_connection = True
                return
            self.wfile.write(chunk)
            left -= len(chunk)

    def _unchanged(self, tag: str, modified: float) -> bool:
        known = self.headers.get("If-None-Match")
        if known is not None:
            return tag in [item.strip().removeprefix("W/") for item in known.split(",")]
        since = self.headers.get("If-Modified-Since")
        try:
            return since is not None and int(modified) <= parsedate_to_datetime(since).timestamp()
        except (TypeError, ValueError):
            return False

    def _send_common(self, tag: str, modified: float) -> None:
        self.send_header("ETag", tag)
        self.send_header("Last-Modified", formatdate(modified, usegmt=True))
        self.send_header("Accept-Ranges", "bytes")
        # A reel can be replaced or grow: ask before using a copy.
        self.send_header("Cache-Control", "no-cache")
        self.send_header("X-Content-Type-Options", "nosniff")
        self._send_cors()

    def _send_cors(self) -> None:
        """Any page may read a reel: what is served is public to whoever reaches the port."""
        self.send_header("Access-Control-Allow-Origin", "*")
        self.send_header("Access-Control-Allow-Methods", "GET, HEAD, OPTIONS")
        self.send_header("Access-Control-Allow-Headers", "Range, If-None-Match")
        self.send_header("Access-Control-Expose-Headers", "Content-Length, Content-Range, Accept-Ranges, ETag")
        self.send_header("Cross-Origin-Resource-Policy", "cross-origin")

    def _refuse(self, status: HTTPStatus, body: bool) -> None:
        text = f"{status.value} {status.phrase}\n".encode()
        self.send_response(status)
        self.send_header("Content-Type", "text/plain; charset=utf-8")
        self.send_header("Content-Length", str(len(text)))
        self.send_header("X-Content-Type-Options", "nosniff")
        self._send_cors()
        self.end_headers()
        if body:
            self.wfile.write(text)


def _parse_range(header: str | None, size: int) -> tuple[int, int] | tuple[()] | None:
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
