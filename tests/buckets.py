"""Local servers of buckets and web pages, with and without faults, and addresses with connection errors."""

from __future__ import annotations

import functools
import http.server
import json
import logging
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import pytest

from splatreel.storage.address import Address
from splatreel.storage.transport import Headers, Transport

CREDENTIALS = {"AWS_ACCESS_KEY_ID": "key", "AWS_SECRET_ACCESS_KEY": "secret", "AWS_DEFAULT_REGION": "us-east-1"}
CORS = {
    "CORSRules": [
        {
            "AllowedOrigins": ["*"],
            "AllowedMethods": ["GET", "HEAD"],
            "AllowedHeaders": ["Range", "If-Match", "If-None-Match"],
            "ExposeHeaders": ["Content-Length", "Content-Range", "ETag"],
            "MaxAgeSeconds": 86400,
        }
    ]
}
"""CORS rules of docs/publishing.md; a test compares the two."""


def readable_by_all(bucket: str) -> dict[str, Any]:
    """Return the bucket policy of docs/publishing.md."""
    rule = {"Effect": "Allow", "Principal": "*", "Action": "s3:GetObject", "Resource": f"arn:aws:s3:::{bucket}/*"}
    return {"Version": "2012-10-17", "Statement": [rule]}


def by_tags_first(app: Any) -> Any:
    """Return a WSGI app that ignores If-Modified-Since if If-None-Match is given (RFC 9110, 13.1.3), as S3 does.

    moto considers both, and reports a manifest rewritten within the same second as unchanged.
    """

    def answered(environ: dict[str, Any], start_response: Any) -> Any:
        if "HTTP_IF_NONE_MATCH" in environ:
            environ.pop("HTTP_IF_MODIFIED_SINCE", None)
        return app(environ, start_response)

    return answered


@contextmanager
def s3_server() -> Iterator[str]:
    """Return the server's address. Pages of other sites may do only what a bucket's rules allow."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MOTO_DISABLE_GLOBAL_CORS", "true")
        moto = pytest.importorskip("moto.moto_server.threaded_moto_server")
        dispatcher = moto.DomainDispatcherApplication
        patch.setattr(moto, "DomainDispatcherApplication", lambda backend: by_tags_first(dispatcher(backend)))
        server = moto.ThreadedMotoServer("127.0.0.1", 0, verbose=False)
        logging.getLogger("werkzeug").setLevel("ERROR")
        server.start()
        host, port = server.get_host_and_port()
        yield f"http://{host}:{port}"
        server.stop()


@dataclass(frozen=True)
class Bucket:
    """Empty bucket. `client` is boto3's."""

    name: str
    server: str
    client: Any

    def url(self, path: str) -> str:
        """Address for Splatreel."""
        return f"s3://{self.name}/{path}"

    def web(self, path: str) -> str:
        """Address for browsers."""
        return f"{self.server}/{self.name}/{path}"

    def open_to_pages(self) -> None:
        """Set the permissions of docs/publishing.md."""
        self.client.put_bucket_cors(Bucket=self.name, CORSConfiguration=CORS)
        self.client.put_bucket_policy(Bucket=self.name, Policy=json.dumps(readable_by_all(self.name)))

    def upload(self, folder: Path, path: str) -> str:
        """Copy a folder, and return its address for Splatreel."""
        for file in folder.rglob("*"):
            if file.is_file():
                key = f"{path}/{file.relative_to(folder).as_posix()}"
                self.client.put_object(Bucket=self.name, Key=key, Body=file.read_bytes())
        return self.url(path)

    def keys(self, prefix: str) -> list[str]:
        """Return up to 1000 names with a prefix."""
        found = self.client.list_objects_v2(Bucket=self.name, Prefix=prefix)
        return [entry["Key"] for entry in found.get("Contents", [])]

    def headers(self, key: str) -> dict[str, str]:
        return self.client.head_object(Bucket=self.name, Key=key)["ResponseMetadata"]["HTTPHeaders"]


class Faults:
    """WSGI middleware that spoils requests for files by a `fault`, which is the name of a method.

    Attributes:
        fault: Name of the fault.
        methods: Methods of the spoiled requests.
        left: Number of requests to spoil. None spoils the first request of each file.
        met: Number of spoiled requests.
    """

    def __init__(self, app: Any) -> None:
        self.app, self.fault, self.methods, self.met = app, "", ("PUT",), 0
        self.left: int | None = 0
        self.seen: set[str] = set()
        self.lock = threading.Lock()

    def begin(self, fault: str, methods: tuple[str, ...] = ("PUT",), left: int | None = None) -> None:
        """Spoil requests from now on."""
        self.fault, self.methods, self.left, self.met, self.seen = fault, methods, left, 0, set()

    def __call__(self, environ: dict[str, Any], start_response: Any) -> Iterable[bytes]:
        with self.lock:
            spoiled = self.spoils(environ["REQUEST_METHOD"], environ["PATH_INFO"])
            self.met += spoiled
        return getattr(self, self.fault)(environ, start_response) if spoiled else self.app(environ, start_response)

    def spoils(self, method: str, path: str) -> bool:
        if method not in self.methods or (method == "PUT" and path.count("/") < 2):
            return False
        if self.left is None:
            is_first = path not in self.seen
            self.seen.add(path)
            return is_first
        self.left -= 1
        return self.left >= 0

    def refused(self, environ: dict[str, Any], start_response: Any, status: str, code: str) -> Iterable[bytes]:
        environ["wsgi.input"].read(int(environ.get("CONTENT_LENGTH") or 0))
        start_response(status, [("Content-Type", "application/xml")])
        return [f"<Error><Code>{code}</Code><Message>{code}, in words</Message></Error>".encode()]

    def fails(self, environ: dict[str, Any], start_response: Any) -> Iterable[bytes]:
        return self.refused(environ, start_response, "500 Internal Server Error", "InternalError")

    def is_busy(self, environ: dict[str, Any], start_response: Any) -> Iterable[bytes]:
        return self.refused(environ, start_response, "503 Service Unavailable", "ServiceUnavailable")

    def is_private(self, environ: dict[str, Any], start_response: Any) -> Iterable[bytes]:
        return self.refused(environ, start_response, "403 Forbidden", "AccessDenied")

    def is_slow(self, environ: dict[str, Any], start_response: Any) -> Iterable[bytes]:
        time.sleep(0.3)
        return self.app(environ, start_response)

    def cuts(self, environ: dict[str, Any], start_response: Any) -> Iterable[bytes]:
        """Accept half of the data and refuse it as incomplete, or send half of it."""
        if environ["REQUEST_METHOD"] == "GET":
            whole = b"".join(self.app(environ, start_response))
            return [whole[: len(whole) // 2]]
        environ["wsgi.input"].read(int(environ.get("CONTENT_LENGTH") or 0) // 2)
        start_response("400 Bad Request", [("Content-Type", "application/xml"), ("Connection", "close")])
        return [
            b"<Error><Code>IncompleteBody</Code><Message>The request body terminated unexpectedly</Message></Error>"
        ]

    def ignores_ranges(self, environ: dict[str, Any], start_response: Any) -> Iterable[bytes]:
        environ.pop("HTTP_RANGE", None)
        return self.app(environ, start_response)

    def tags_wrongly(self, environ: dict[str, Any], start_response: Any) -> Iterable[bytes]:
        def start(status: str, headers: list[tuple[str, str]], *rest: Any) -> Any:
            others = [(name, value) for name, value in headers if name.lower() != "etag"]
            return start_response(status, [*others, ("ETag", '"0123456789abcdef0123456789abcdef"')], *rest)

        return self.app(environ, start)


@contextmanager
def faulty_server() -> Iterator[tuple[str, Faults]]:
    """Return the address of another S3-compatible server, and its faults."""
    moto = pytest.importorskip("moto.moto_server.threaded_moto_server")
    made: list[Faults] = []
    with pytest.MonkeyPatch.context() as patch:
        dispatcher = moto.DomainDispatcherApplication

        def spoiled(backend: Any) -> Faults:
            made.append(Faults(by_tags_first(dispatcher(backend))))
            return made[-1]

        patch.setattr(moto, "DomainDispatcherApplication", spoiled)
        running = moto.ThreadedMotoServer("127.0.0.1", 0, verbose=False)
        running.start()
        host, port = running.get_host_and_port()
        yield f"http://{host}:{port}", made[0]
        running.stop()


class FaultyWeb(http.server.SimpleHTTPRequestHandler):
    """Handler of a web server that ignores ranges, with a fault for the first request of each file or for all requests."""

    faults: ClassVar[dict[str, Any]]

    def do_GET(self) -> None:
        path = self.path.partition("?")[0]
        self.faults["asked"].append(self.path)
        is_first = path not in self.faults["seen"]
        self.faults["seen"].add(path)
        fault = self.faults["fault"]
        if isinstance(fault, int) and (is_first or self.faults["always"]):
            self.send_error(fault)
        elif fault == "cuts" and is_first:
            data = Path(self.translate_path(path)).read_bytes()
            self.send_response(200)
            self.send_header("Content-Length", str(len(data)))
            self.end_headers()
            self.wfile.write(data[: len(data) // 2])
        elif fault == "hangs up" and is_first:
            self.close_connection = True
        else:
            super().do_GET()

    def log_message(self, format: str, *arguments: Any) -> None:
        pass


@contextmanager
def web_server(folder: Path, fault: int | str | None = None, always: bool = False) -> Iterator[tuple[str, list[str]]]:
    """Serve a folder with a fault: an HTTP status, "cuts" or "hangs up". Return the address and the requested paths."""
    faults: dict[str, Any] = {"fault": fault, "always": always, "seen": set(), "asked": []}
    kind = type("Handler", (FaultyWeb,), {"faults": faults})
    handler = functools.partial(kind, directory=str(folder))
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}", faults["asked"]
    server.shutdown()
    server.server_close()


class BreakingLine:
    """Transport that fails at given writes, counted from 0, and logs all writes.

    With `halves`, the connection fails after the file has arrived, before the response.
    """

    def __init__(self, transport: Transport, breaks: set[int], halves: bool = False) -> None:
        self.transport, self.breaks, self.halves = transport, breaks, halves
        self.log: list[str] = []
        self.writes = 0
        self._lock = threading.Lock()

    def read(self, name: str, begin: int, end: int) -> bytes:
        return self.transport.read(name, begin, end)

    def write(self, name: str, data: bytes, headers: Headers) -> None:
        with self._lock:
            number, self.writes = self.writes, self.writes + 1
        if number not in self.breaks or self.halves:
            self.transport.write(name, data, headers)
            self.log.append(name)
        if number in self.breaks:
            raise ConnectionError("the line is cut")

    def sizes(self, prefix: str) -> dict[str, int]:
        return self.transport.sizes(prefix)

    def remove(self, name: str) -> None:
        self.transport.remove(name)
        self.log.append(f"-{name}")


def breaking(
    location: str | Path | Address, breaks: set[int] | None = None, halves: bool = False, pauses: tuple[float, ...] = ()
) -> tuple[Address, BreakingLine]:
    """Return an address whose given writes fail, and its line."""
    address = location if isinstance(location, Address) else Address(location, pauses=pauses)
    line = BreakingLine(address._transport, set() if breaks is None else breaks, halves)
    address._transport = line
    return address, line
