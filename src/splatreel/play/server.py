"""HTTP server of the web player and one reel, read-only and by default for this machine only."""

from __future__ import annotations

import asyncio
import ipaddress
import logging
import os
import socket
import threading
import time
import webbrowser
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import cast

import uvicorn

from splatreel.base.errors import ReelError, UsageError
from splatreel.codec.preview import newest_preview
from splatreel.play.allowed_hosts import AllowedHosts
from splatreel.play.connection import HEAD_BYTES, IDLE_SECONDS, ConnectionLimits
from splatreel.play.served_files import ReelFiles, RemoteFiles, RunFiles, ServedFiles
from splatreel.play.web_app import ServedPage, WebApp
from splatreel.storage.address import local_path

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
    """Return the files of a reel. Raises `ReelError` if there is none."""
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
    limits = ConnectionLimits(site, _connection_limit())
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
        h11_max_incomplete_event_size=HEAD_BYTES,
    )


def _connection_limit() -> int:
    """Return the maximum number of connections: half of the files that the process may open, since each may need one more."""
    try:
        import resource
    except ImportError:  # Windows
        return _MAX_CONNECTIONS
    return max(min(_MAX_CONNECTIONS, (resource.getrlimit(resource.RLIMIT_NOFILE)[0] - 64) // 2), 16)
