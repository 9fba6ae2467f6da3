"""HTTP hosts with custom headers."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path


class _Handler(SimpleHTTPRequestHandler):
    def __init__(self, *args: object, pages: dict[str, str], headers: dict[str, str], **options: object) -> None:
        self.pages, self.extra = pages, headers
        super().__init__(*args, **options)  # type: ignore[arg-type]

    def do_GET(self) -> None:
        text = self.pages.get(self.path.split("?")[0])
        if text is None:
            return super().do_GET()
        self.send_response(200)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.end_headers()
        self.wfile.write(text.encode())

    def end_headers(self) -> None:
        for name, value in self.extra.items():
            self.send_header(name, value)
        super().end_headers()

    def log_message(self, format: str, *args: object) -> None: ...


@contextmanager
def host(folder: Path, pages: dict[str, str] | None = None, headers: dict[str, str] | None = None) -> Iterator[str]:
    """Serve a folder's files and pages (texts by path) with these headers until the block ends, and yield the address."""
    handler = partial(_Handler, directory=str(folder), pages=pages or {}, headers=headers or {})
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as running:
        running.daemon_threads = True
        threading.Thread(target=running.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{running.server_address[1]}/"
        running.shutdown()
