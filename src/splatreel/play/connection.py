"""Limits that uvicorn leaves to a reverse proxy: bounded requests, bounded waiting times, and a bounded number of connections."""

from __future__ import annotations

import asyncio
import re
import socket
from typing import Any

from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

HEAD_BYTES = 16 << 10
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


class ConnectionLimits:
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

    def __init__(self, limits: ConnectionLimits, *args: Any, **options: Any) -> None:
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
        """Pass data on in pieces of at most `HEAD_BYTES`, so that longer headers are refused before they are parsed."""
        for start in range(0, len(data), HEAD_BYTES):
            piece = data[start : start + HEAD_BYTES]
            if self._channel.is_closing():
                return
            if self._answering or self._complete:  # the next request, or a body, which no response needs
                self._ahead += len(piece)
                if self._ahead > HEAD_BYTES:
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
