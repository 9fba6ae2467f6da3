"""Serve a folder to a browser on this machine, at full speed or like a slow network."""

import gzip
import io
import re
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import BinaryIO

_CHUNK = 2048
_TEXTS = (".html", ".js", ".json", ".css", ".wasm")


class Line:
    """A network line that all responses share: a rate, a latency, and files that are held back."""

    def __init__(self, mbit: float = float("inf"), latency: float = 0.0) -> None:
        """Set the line up.

        Args:
            mbit: Rate, Mbit/s.
            latency: Delay of each response, seconds.
        """
        self.rate = mbit * 1e6 / 8
        self.latency = latency
        self.held: re.Pattern[str] | None = None
        self.released = threading.Event()
        self._free = 0.0
        self._lock = threading.Lock()

    def wait(self, path: str) -> None:
        """Wait before a response."""
        time.sleep(self.latency)
        if self.held and self.held.search(path):
            self.released.wait()

    def pass_through(self, count: int, ready: float) -> float:
        """Return when this many bytes have had their turn.

        Threads wake up late on a busy machine. The line makes up for that, since a network does not wait for them.

        Args:
            count: Number of bytes.
            ready: Time at which the bytes could be sent.

        Returns:
            Time at which they had their turn.
        """
        with self._lock:
            self._free = due = max(self._free, ready) + count / self.rate
        time.sleep(max(due - time.monotonic(), 0))
        return due


class _Handler(SimpleHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def __init__(self, *args: object, line: Line, **options: object) -> None:
        self.line = line
        super().__init__(*args, **options)  # type: ignore[arg-type]

    def do_GET(self) -> None:
        self.line.wait(self.path)
        super().do_GET()

    def send_head(self) -> BinaryIO | None:  # type: ignore[override]
        """Compress text, as web hosts do."""
        path = Path(self.translate_path(self.path))
        if path.is_dir() or path.suffix not in _TEXTS or not path.is_file():
            return super().send_head()  # type: ignore[return-value]
        data = gzip.compress(path.read_bytes(), 6)
        self.send_response(200)
        self.send_header("Content-Type", self.guess_type(str(path)))
        self.send_header("Content-Encoding", "gzip")
        self.send_header("Content-Length", str(len(data)))
        self.send_header("Last-Modified", self.date_time_string(int(path.stat().st_mtime)))
        self.end_headers()
        return io.BytesIO(data)

    def copyfile(self, source: BinaryIO, outputfile: BinaryIO) -> None:  # type: ignore[override]
        ready = time.monotonic()
        while data := source.read(_CHUNK):
            ready = self.line.pass_through(len(data), ready)
            outputfile.write(data)

    def log_message(self, format: str, *args: object) -> None:
        """Print nothing: the terminal is for results."""


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def handle_error(self, request: object, client_address: object) -> None:
        """Ignore pages that close during a response."""


@contextmanager
def serve_folder(folder: Path, line: Line | None = None) -> Iterator[str]:
    """Yield the address of a folder's files until the block ends."""
    server = _Server(("127.0.0.1", 0), partial(_Handler, directory=str(folder), line=line or Line()))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}/"
    finally:
        server.shutdown()
        server.server_close()
