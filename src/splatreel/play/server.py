"""HTTP server of the web player and one reel, read-only and by default for this machine only."""

from __future__ import annotations

import asyncio
import ipaddress
import logging
import os
import re
import socket
import threading
import time
import webbrowser
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any, cast

import uvicorn
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from splatreel.base.errors import ReelError, UsageError
from splatreel.codec.preview import newest_preview
from splatreel.play.served_files import ReelFiles, RemoteFiles, RunFiles, ServedFiles
from splatreel.play.web_app import AllowedHosts, ServedPage, WebApp
from splatreel.storage.address import local_path

_HEAD_BYTES = 16 << 10
"""Maximum size of the request line and headers."""
REQUEST_SECONDS = 10
"""Time within which the headers of a request must be complete."""
IDLE_SECONDS = 30
"""Time for which a connection is kept open between requests."""
STALL_SECONDS = 60
"""Time after which a reader that takes less than about 48 KB has stalled."""
_UNSENT_BYTES = 64 << 10
"""Bytes that the system buffers unsent, if it can be told. A small buffer reveals a slow reader soon."""
_HEAD_END = re.compile(rb"\n\r?\n")


class _ConnectionLimits:
    """ASGI middleware that tells each connection when a request begins and ends, and limits the number of connections.

    Pass `connect` to uvicorn as its HTTP protocol.
    """

    def __init__(self, app: ASGIApp, max_connections: int) -> None:
        """Wrap an application. If more than `max_connections` are open, the one that has waited longest is closed."""
        self._app = app
        self._max = max_connections
        self._open: dict[tuple[str, int], Connection] = {}

    def connect(self, *args: Any, **options: Any) -> Connection:
        """Create the protocol of one connection."""
        return Connection(self, *args, **options)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on."""
        connection = self._open.get(scope.get("client") or ("", 0))
        if connection is None:  # it has closed already
            return await self._app(scope, receive, send)
        connection.begin_response()
        complete = False

        async def send_and_report(message: Message) -> None:
            nonlocal complete
            if message["type"] == "http.response.start" and connection.is_last_response:
                message = {**message, "headers": [*message["headers"], (b"connection", b"close")]}
            await send(message)
            if message["type"] == "http.response.body" and not message.get("more_body"):
                complete = True  # uvicorn may begin the next request before the application returns
                connection.end_response()

        try:
            await self._app(scope, receive, send_and_report)
        finally:
            if not complete:
                connection.end_response()

    def add(self, connection: Connection) -> None:
        """Register a new connection, and make room for it."""
        self._open[connection.peer] = connection
        if len(self._open) > self._max:
            waiting = [other for other in self._open.values() if other is not connection and other.is_waiting]
            closed = min(waiting, key=lambda other: other.waiting_since, default=connection)
            self.remove(closed)
            closed.shutdown()

    def remove(self, connection: Connection) -> None:
        """Forget a connection."""
        if self._open.get(connection.peer) is connection:
            del self._open[connection.peer]


class Connection(H11Protocol):
    """An HTTP connection that closes itself if its peer keeps it waiting.

    It overrides the methods of `asyncio.Protocol` and the `shutdown` that uvicorn calls, and uses no other part of `H11Protocol`.
    """

    peer = ("", 0)
    """Address and port of the peer, as in the `client` of an ASGI scope."""
    is_last_response = False
    """True if the connection closes after the present response."""
    waiting_since = 0.0
    """Loop time at which the present wait for the peer began."""

    _channel: asyncio.Transport
    _timer: asyncio.TimerHandle | None = None
    _answering = False
    _writing_paused = False
    _begun = True
    _tail = b""
    _complete = 0
    _ahead = 0

    def __init__(self, limits: _ConnectionLimits, *args: Any, **options: Any) -> None:
        """Create the protocol. args, options: given by uvicorn."""
        super().__init__(*args, **options)
        self._limits = limits

    @property
    def is_waiting(self) -> bool:
        """True while the connection waits for its peer."""
        return self._timer is not None and not self._channel.is_closing()

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Wait for the first request."""
        super().connection_made(transport)
        self._channel = transport
        name = transport.get_extra_info("peername")
        self.peer = (str(name[0]), int(name[1])) if name else ("", 0)
        unsent = getattr(socket, "TCP_NOTSENT_LOWAT", None)
        if unsent is not None:
            transport.get_extra_info("socket").setsockopt(socket.IPPROTO_TCP, unsent, _UNSENT_BYTES)
        self._wait(REQUEST_SECONDS)
        self._limits.add(self)

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the connection."""
        self._stop_waiting()
        self._limits.remove(self)
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Pass data on in pieces of at most `_HEAD_BYTES`, so that longer headers are refused before they are parsed."""
        for start in range(0, len(data), _HEAD_BYTES):
            piece = data[start : start + _HEAD_BYTES]
            if self._channel.is_closing():
                return
            if self._answering or self._complete:  # the next request, or a body, which no response needs
                self._ahead += len(piece)
                if self._ahead > _HEAD_BYTES:
                    self.is_last_response = True
                    return
            elif not self._begun:
                self._begun = True
                self._wait(REQUEST_SECONDS)
            self._count_requests(piece)
            super().data_received(piece)

    def _count_requests(self, piece: bytes) -> None:
        seen, end = self._tail + piece, 0
        for match in _HEAD_END.finditer(seen):
            self._complete, end = self._complete + 1, match.end()
        self._tail = seen[end:][-2:]

    def begin_response(self) -> None:
        """Stop waiting, since it is the server's turn."""
        self._answering = True
        self._complete = max(self._complete - 1, 0)
        if not self._writing_paused:
            self._stop_waiting()

    def end_response(self) -> None:
        """Wait for the next request. If it has arrived already, it is the last one, since pipelined requests delay other peers."""
        self._answering = False
        self._ahead = 0
        if self.is_last_response or self._channel.is_closing():
            self._channel.close()
            self._wait(STALL_SECONDS)
        elif self._complete:
            self.is_last_response = True
        elif self._writing_paused:
            self._wait(STALL_SECONDS)
        else:
            self._begun = bool(self._tail)
            self._wait(REQUEST_SECONDS if self._begun else IDLE_SECONDS)

    def pause_writing(self) -> None:
        """Wait for a slow reader."""
        super().pause_writing()
        self._writing_paused = True
        self._wait(STALL_SECONDS)

    def resume_writing(self) -> None:
        """Go on, since the reader has caught up."""
        super().resume_writing()
        self._writing_paused = False
        if self._answering:
            self._stop_waiting()

    def shutdown(self) -> None:
        """Close at once, without waiting for the response to be read."""
        self._channel.abort()

    def _wait(self, seconds: float) -> None:
        self._stop_waiting()
        loop = asyncio.get_running_loop()
        self.waiting_since = loop.time()
        self._timer = loop.call_later(seconds, self._channel.abort)

    def _stop_waiting(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None


_EVERYWHERE = ("0.0.0.0", "::")
"""Addresses to listen on that stand for all of this machine."""
_MAX_CONNECTIONS = 256
_BACKLOG = 128
_RECEIVE_BYTES = 32 << 10
"""Receive buffer of the system per connection. Requests are small."""
_SECONDS_TO_CLOSE = 2


class Server:
    """An HTTP server of the player and a reel, on a thread of its own.

    It is also a context manager: `with serve(path) as server:`.
    """

    def __init__(
        self,
        reel: str | Path | ReelFiles,
        host: str = "127.0.0.1",
        port: int = 0,
        cors: bool = False,
        allow_hosts: Iterable[str] = (),
        pages: Mapping[str, ServedPage] = MappingProxyType({}),
        reels: Mapping[str, ReelFiles] = MappingProxyType({}),
    ) -> None:
        """Listen, without answering before `start`. See `serve`; `pages` are further pages and `reels` further reels by name."""
        files = _files(reel) if isinstance(reel, str | Path) else reel
        self._socket = _listen(host, port)
        self._address: tuple[str, int] = self._socket.getsockname()[:2]
        try:
            site = WebApp(files, AllowedHosts(self._address[0], host, allow_hosts), cors, pages, reels)
        except UsageError:
            self._socket.close()
            raise
        self._http = uvicorn.Server(_config(site))
        self._thread = threading.Thread(
            target=self._http.run, args=([self._socket],), name="splatreel-server", daemon=True
        )
        self._started = False

    @property
    def url(self) -> str:
        """URL of the player."""
        host, port = self._address
        return _url("localhost" if host in _EVERYWHERE else host, port)

    @property
    def network_url(self) -> str | None:
        """URL of the player for other machines of the network; None if it admits none, or this machine has no network."""
        host, port = self._address
        if host in _EVERYWHERE:
            found = _network_address(host)
            return _url(found, port) if found else None
        return None if ipaddress.ip_address(host.split("%")[0]).is_loopback else _url(host, port)

    def start(self) -> Server:
        """Begin to answer requests, and return at once."""
        if not self._started:
            self._started = True
            self._thread.start()
        return self

    def wait(self) -> None:
        """Block until another thread calls `close`, or until Ctrl-C."""
        while self._thread.is_alive():
            time.sleep(0.2)  # on Python 3.11, `join` interrupted by Ctrl-C marks the thread as ended

    def close(self) -> None:
        """Stop at once, abort running responses, and free the port."""
        if self._started:
            self._http.should_exit = True
            self._thread.join()
        self._socket.close()

    def __enter__(self) -> Server:
        return self.start()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def serve(
    reel_path: str | Path,
    host: str = "127.0.0.1",
    port: int = 8080,
    open_browser: bool = False,
    cors: bool = False,
    allow_hosts: Iterable[str] = (),
) -> Server:
    """Start a server of the player and a reel.

    Args:
        reel_path: Directory of the reel, or its URL. Files of a remote reel are fetched on request.
        host: Address to listen on.
        port: Port to listen on; 0 takes any free one.
        open_browser: Whether to open the player in a browser.
        cors: Whether pages of other sites may read the reel.
        allow_hosts: Host names to answer to, beside the server's own, such as that of a proxy.

    Returns:
        The running server: `url` is the player's address, `wait` blocks, and `close` ends it.

    Raises:
        ReelError: There is no reel at `reel_path`.
        UsageError: The address cannot be used.
    """
    server = Server(reel_path, host, port, cors, allow_hosts).start()
    if open_browser:
        webbrowser.open(server.url)
    return server


def _files(location: str | Path) -> ReelFiles:
    path = local_path(location)
    if path is None:
        return RemoteFiles(str(location))
    if not (path / "manifest.json").is_file():
        if newest_preview(path) is not None:
            return RunFiles(path)
        raise ReelError(f"{location} is not a reel: it has no manifest.json. Name the folder of a reel.")
    return ServedFiles(path)


def _listen(host: str, port: int) -> socket.socket:
    listener = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET)
    try:
        if os.name == "posix":  # on Windows this option would share the port with another server
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BYTES)
        listener.bind((host, port))
        listener.listen(_BACKLOG)  # connections wait until the thread runs
    except (OSError, OverflowError) as error:
        listener.close()
        reason = error.strerror if isinstance(error, OSError) else error
        raise UsageError(f"Cannot listen on {host}:{port} ({reason}). Choose another host or port.") from error
    return listener


def _url(host: str, port: int) -> str:
    return f"http://[{host}]:{port}/" if ":" in host else f"http://{host}:{port}/"


def _network_address(everywhere: str) -> str | None:
    """Return the address by which this machine reaches other networks; None without a network."""
    family, test_network = (
        (socket.AF_INET, "192.0.2.1") if everywhere == "0.0.0.0" else (socket.AF_INET6, "2001:db8::1")
    )
    try:
        with socket.socket(family, socket.SOCK_DGRAM) as probe:
            probe.connect((test_network, 9))  # this chooses a route and sends nothing
            return str(probe.getsockname()[0])
    except OSError:
        return None


def _config(site: WebApp) -> uvicorn.Config:
    """Return a configuration that logs nothing, since the command line reports to the terminal itself."""
    limits = _ConnectionLimits(site, _connection_limit())
    return uvicorn.Config(
        limits,
        loop="asyncio",
        http=cast(type[asyncio.Protocol], limits.connect),
        ws="none",
        lifespan="off",
        log_config=None,
        log_level=logging.CRITICAL,
        access_log=False,
        proxy_headers=False,
        server_header=False,
        backlog=_BACKLOG,
        timeout_keep_alive=IDLE_SECONDS,
        timeout_graceful_shutdown=_SECONDS_TO_CLOSE,
        h11_max_incomplete_event_size=_HEAD_BYTES,
    )


def _connection_limit() -> int:
    """Return the maximum number of connections: half of the files that the process may open, since each may need one more."""
    try:
        import resource
    except ImportError:  # Windows
        return _MAX_CONNECTIONS
    return max(min(_MAX_CONNECTIONS, (resource.getrlimit(resource.RLIMIT_NOFILE)[0] - 64) // 2), 16)
