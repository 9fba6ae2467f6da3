"""HTTP hosts with custom headers."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path


class _Handler(SimpleHTTPRequestHandler):
    def __init__(
        self,
        *args: object,
        pages: dict[str, str],
        headers: dict[str, str],
        admits: Callable[["_Handler"], bool],
        **options: object,
    ) -> None:
        self.pages, self.extra, self.admits = pages, headers, admits
        super().__init__(*args, **options)  # type: ignore[arg-type]

    def do_GET(self) -> None:
        if not self.admits(self):
            return self.send_error(403)
        text = self.pages.get(self.path.split("?")[0])
        if text is None:
            return super().do_GET()
        self.send_response(200)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.end_headers()
        self.wfile.write(text.encode())

    def do_OPTIONS(self) -> None:
        self.send_response(204)
        self.end_headers()

    def end_headers(self) -> None:
        for name, value in self.extra.items():
            self.send_header(name, value)
        super().end_headers()

    def log_message(self, format: str, *args: object) -> None: ...


@contextmanager
def host(
    folder: Path,
    pages: dict[str, str] | None = None,
    headers: dict[str, str] | None = None,
    admits: Callable[[_Handler], bool] = lambda request: True,
) -> Iterator[str]:
    """Serve a folder's files and pages (texts by path) with these headers until the block ends, and yield the address.

    Requests that `admits` returns False for are answered 403.
    """
    handler = partial(_Handler, directory=str(folder), pages=pages or {}, headers=headers or {}, admits=admits)
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as running:
        running.daemon_threads = True
        threading.Thread(target=running.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{running.server_address[1]}/"
        running.shutdown()
