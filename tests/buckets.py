"""A local S3-compatible server, buckets in it, and addresses with connection errors."""

from __future__ import annotations

import json
import logging
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

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

    def keys(self, prefix: str) -> list[str]:
        """Return up to 1000 names with a prefix."""
        found = self.client.list_objects_v2(Bucket=self.name, Prefix=prefix)
        return [entry["Key"] for entry in found.get("Contents", [])]

    def headers(self, key: str) -> dict[str, str]:
        return self.client.head_object(Bucket=self.name, Key=key)["ResponseMetadata"]["HTTPHeaders"]


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
