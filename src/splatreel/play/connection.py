"""An HTTP connection with the limits that uvicorn leaves to a reverse proxy: requests of bounded size that arrive in bounded time,
readers that keep reading, and a bounded number of connections."""

from __future__ import annotations

import asyncio
import socket
from typing import cast

from uvicorn.protocols.http.h11_impl import H11Protocol

HEAD_BYTES = 16 << 10
"""Longest request line and headers."""
REQUEST_SECONDS = 10
"""A request's headers must be whole within this time."""
IDLE_SECONDS = 30
"""A connection is kept this long between requests."""
STALL_SECONDS = 60
"""A reader that takes less than about 48 KB in this time has stalled."""
_UNSENT = 64 << 10
"""Bytes that the system holds back unsent, where it can be told: so what a slow reader takes is seen soon."""


class Connection(H11Protocol):
    """Closes itself when its peer keeps it waiting, and the one that waited longest where there are too many."""

    _timer: asyncio.TimerHandle | None = None
    _since = 0.0
    _begun = True
    _ahead = 0

    @property
    def busy(self) -> bool:
        """Whether a request is being answered."""
        return self.cycle is not None and not self.cycle.response_complete

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        unsent = getattr(socket, "TCP_NOTSENT_LOWAT", None)
        if unsent is not None:
            transport.get_extra_info("socket").setsockopt(socket.IPPROTO_TCP, unsent, _UNSENT)
        self._wait(REQUEST_SECONDS)
        if self.limit_concurrency is not None and len(self.connections) > self.limit_concurrency // 2:
            self._make_room()

    def connection_lost(self, exc: Exception | None) -> None:
        self._go_on()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Handed on in pieces of at most the size of a request, so that a longer one is refused before it is taken apart."""
        for start in range(0, len(data), HEAD_BYTES):
            piece = data[start : start + HEAD_BYTES]
            if self.transport.is_closing():
                return
            if self.busy:  # the next request already, or a body, which nobody reads
                self._ahead += len(piece)
                if self._ahead > HEAD_BYTES:
                    self.cycle.keep_alive = False
                    return
            elif not self._begun:
                self._begun = True
                self._wait(REQUEST_SECONDS)
            super().data_received(piece)
            if self.busy and not self.flow.write_paused:
                self._go_on()

    def on_response_complete(self) -> None:
        """A request that came before this answer was complete is answered as well, and then the connection ends: thousands in
        one go would delay others, and browsers send none so."""
        self._ahead = 0
        super().on_response_complete()
        if self.busy:
            self.cycle.keep_alive = False
            if not self.flow.write_paused:
                self._go_on()
        elif self.flow.write_paused or self.transport.is_closing():
            self._wait(STALL_SECONDS)
        else:
            self._begun = bool(self.conn.trailing_data[0])
            self._wait(REQUEST_SECONDS if self._begun else IDLE_SECONDS)

    def pause_writing(self) -> None:
        super().pause_writing()
        self._wait(STALL_SECONDS)

    def resume_writing(self) -> None:
        super().resume_writing()
        if self.busy:
            self._go_on()

    def shutdown(self) -> None:
        self.transport.abort()

    def _wait(self, seconds: float) -> None:
        """For the peer, no longer than this."""
        self._go_on()
        self._since = self.loop.time()
        self._timer = self.loop.call_later(seconds, self.transport.abort)

    def _go_on(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _make_room(self) -> None:
        """Give up the connection that has waited longest, or this one where all others are being answered."""
        others = [cast(Connection, other) for other in self.connections if other is not self]
        waiting = [other for other in others if other._timer is not None and not other.transport.is_closing()]
        given_up = min(waiting, key=lambda other: other._since) if waiting else self
        self.connections.discard(given_up)
        given_up.transport.abort()
