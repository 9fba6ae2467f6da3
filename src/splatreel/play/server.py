"""Serves the web player and one reel over HTTP: read-only, from this machine only unless asked otherwise."""

from __future__ import annotations

import logging
import os
import socket
import threading
import time
import webbrowser
from collections.abc import Iterable
from pathlib import Path
from types import TracebackType

import uvicorn

from splatreel.errors import ReelError, UsageError
from splatreel.play.allowed_hosts import AllowedHosts
from splatreel.play.connection import HEAD_BYTES, IDLE_SECONDS, Connection
from splatreel.play.remote_files import RemoteFiles
from splatreel.play.served_files import ReelFiles, ServedFiles
from splatreel.play.web_app import WebApp
from splatreel.storage.addresses import local_path

_MOST_CONNECTIONS = 256
_BACKLOG = 128
_RECEIVE_BYTES = 32 << 10
"""Requests are small: more than this the system need not hold of what a client sends."""
_SECONDS_TO_CLOSE = 2


class Server:
    """An HTTP server of the player and a reel, on a thread of its own. Also a context manager: `with serve(path) as server:`.

    reel_path: the reel's directory, or its URL, whose files are then fetched as they are asked for.
    cors: whether pages of other sites may read the reel. allow_hosts: names that it may be asked for as, beside its own.
    """

    def __init__(
        self,
        reel_path: str | Path,
        host: str = "127.0.0.1",
        port: int = 0,
        cors: bool = False,
        allow_hosts: Iterable[str] = (),
    ) -> None:
        reel = _files(reel_path)
        self._socket = _listen(host, port)
        self._address: tuple[str, int] = self._socket.getsockname()[:2]
        try:
            site = WebApp(reel, AllowedHosts(self._address[0], host, allow_hosts), cors)
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
        """Address of the player."""
        host, port = self._address
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
            time.sleep(0.2)  # Python 3.11 takes a thread for ended when Ctrl-C interrupts `join`

    def close(self) -> None:
        """Stop answering, also what is being answered, and free the port."""
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
    port: int = 8000,
    open_browser: bool = False,
    cors: bool = False,
    allow_hosts: Iterable[str] = (),
) -> Server:
    """Start serving a reel, a directory or a URL, and the player; port 0 takes any free one.

    Returns the running server: `.url` opens the player, `.wait()` blocks, `.close()` ends it. cors: whether pages of other
    sites may read the reel; allow_hosts: names that it may be asked for as, beside its own (of a proxy before it, say).
    Raises `ReelError` if reel_path holds no reel, `UsageError` if the address cannot be used.
    """
    server = Server(reel_path, host, port, cors, allow_hosts).start()
    if open_browser:
        webbrowser.open(server.url)
    return server


def _files(location: str | Path) -> ReelFiles:
    """Raises `ReelError` where there is no reel."""
    path = local_path(location)
    if path is None:
        return RemoteFiles(str(location))
    if not (path / "manifest.json").is_file():
        raise ReelError(f"{location} is not a reel: it has no manifest.json. Give the directory that `encode` wrote.")
    return ServedFiles(path)


def _listen(host: str, port: int) -> socket.socket:
    listener = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET)
    try:
        if os.name == "posix":  # elsewhere it would share the port with another server
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BYTES)
        listener.bind((host, port))
        listener.listen(_BACKLOG)  # who comes before the thread runs waits for it
    except (OSError, OverflowError) as error:
        listener.close()
        reason = error.strerror if isinstance(error, OSError) else error
        raise UsageError(f"Cannot listen on {host}:{port} ({reason}). Choose another host or port.") from error
    return listener


def _config(site: WebApp) -> uvicorn.Config:
    """Quiet, since the terminal belongs to the person who started the server; what others send is no news."""
    return uvicorn.Config(
        site,
        loop="asyncio",
        http=Connection,
        ws="none",
        lifespan="off",
        log_config=None,
        log_level=logging.CRITICAL,
        access_log=False,
        proxy_headers=False,
        server_header=False,
        limit_concurrency=2
        * _most_connections(),  # beyond it uvicorn answers 503; `Connection` makes room at half of it
        backlog=_BACKLOG,
        timeout_keep_alive=IDLE_SECONDS,
        timeout_graceful_shutdown=_SECONDS_TO_CLOSE,
        h11_max_incomplete_event_size=HEAD_BYTES,
    )


def _most_connections() -> int:
    """Each may need a file as well: half of those that the system lets a process open."""
    try:
        import resource
    except ImportError:  # Windows
        return _MOST_CONNECTIONS
    return max(min(_MOST_CONNECTIONS, (resource.getrlimit(resource.RLIMIT_NOFILE)[0] - 64) // 2), 16)
