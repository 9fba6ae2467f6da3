"""Publication to a bucket whose server fails, stalls, truncates or corrupts uploads, or returns wrong tags."""

import threading
import time
from collections.abc import Iterable, Iterator
from typing import Any

import pytest
from splatreel.storage.retrying import RetryingFolder

from splatreel.base.errors import ReelError, StorageError
from splatreel.codec.publish import Publication
from splatreel.codec.verification import verify_reel
from splatreel.storage.address import Address
from tests.buckets import CREDENTIALS, Bucket, by_tags_first
from tests.codec.reels import write_reel


class Faults:
    """WSGI middleware that corrupts the first `left` uploads with a `fault` of `FAULTS`."""

    def __init__(self, app: Any) -> None:
        self.app, self.fault, self.left, self.met = app, "", 0, 0
        self.lock = threading.Lock()

    def __call__(self, environ: dict[str, Any], start_response: Any) -> Iterable[bytes]:
        with self.lock:
            spoiled = environ["REQUEST_METHOD"] == "PUT" and environ["PATH_INFO"].count("/") > 1 and self.left > 0
            self.left -= spoiled
            self.met += spoiled
        return getattr(self, self.fault)(environ, start_response) if spoiled else self.app(environ, start_response)

    def fails(self, environ: dict[str, Any], start_response: Any) -> Iterable[bytes]:
        environ["wsgi.input"].read(int(environ.get("CONTENT_LENGTH") or 0))
        start_response("500 Internal Server Error", [("Content-Type", "application/xml")])
        return [b"<Error><Code>InternalError</Code><Message>We encountered an internal error.</Message></Error>"]

    def is_slow(self, environ: dict[str, Any], start_response: Any) -> Iterable[bytes]:
        time.sleep(0.3)
        return self.app(environ, start_response)

    def cuts(self, environ: dict[str, Any], start_response: Any) -> Iterable[bytes]:
        """Accept half of the data and refuse it as incomplete."""
        environ["wsgi.input"].read(int(environ.get("CONTENT_LENGTH") or 0) // 2)
        start_response("400 Bad Request", [("Content-Type", "application/xml"), ("Connection", "close")])
        return [
            b"<Error><Code>IncompleteBody</Code><Message>The request body terminated unexpectedly</Message></Error>"
        ]

    def tags_wrongly(self, environ: dict[str, Any], start_response: Any) -> Iterable[bytes]:
        def start(status: str, headers: list[tuple[str, str]], *rest: Any) -> Any:
            others = [(name, value) for name, value in headers if name.lower() != "etag"]
            return start_response(status, [*others, ("ETag", '"0123456789abcdef0123456789abcdef"')], *rest)

        return self.app(environ, start)


@pytest.fixture(scope="module")
def server() -> Iterator[tuple[str, Faults]]:
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


@pytest.fixture(autouse=True)
def no_shared_clients() -> Iterator[None]:
    """Clear fsspec's client cache, whose keys do not include the server."""
    s3fs = pytest.importorskip("s3fs")
    s3fs.S3FileSystem.clear_instance_cache()
    yield
    s3fs.S3FileSystem.clear_instance_cache()


@pytest.fixture
def faulty(server: tuple[str, Faults], monkeypatch: pytest.MonkeyPatch) -> tuple[Bucket, Faults]:
    boto3 = pytest.importorskip("boto3")
    pytest.importorskip("s3fs")
    address, faults = server
    settings = {"AWS_ENDPOINT_URL": address, "AWS_MAX_ATTEMPTS": "1", "AWS_RETRY_MODE": "standard"}
    for name, value in {**CREDENTIALS, **settings}.items():
        monkeypatch.setenv(name, value)
    client = boto3.client("s3")
    name = f"faulty-{time.monotonic_ns()}"
    client.create_bucket(Bucket=name)
    faults.met = 0
    return Bucket(name, address, client), faults


@pytest.mark.parametrize(("fault", "times"), [("fails", 2), ("is_slow", 100), ("cuts", 2), ("tags_wrongly", 100)])
def test_publication_is_complete_after_s3_faults(
    faulty: tuple[Bucket, Faults], tmp_path: Any, fault: str, times: int
) -> None:
    bucket, faults = faulty
    reel = write_reel(tmp_path / "reel")
    faults.fault, faults.left = fault, times
    there = RetryingFolder(Address(bucket.url("reel")), pauses=(0.0, 0.0, 0.0, 0.0))
    published = Publication(reel, there).update()
    faults.left = 0
    assert faults.met >= 2
    assert published is not None
    assert verify_reel(bucket.url("reel")).bytes == published.bytes
    again = Publication(reel, there).update()
    assert again is not None
    assert again.sent == 0


def test_failing_server_leaves_no_partial_reel(faulty: tuple[Bucket, Faults], tmp_path: Any) -> None:
    bucket, faults = faulty
    reel = write_reel(tmp_path / "reel")
    faults.fault, faults.left = "fails", 1000
    with pytest.raises(StorageError, match="could not be written"):
        Publication(reel, RetryingFolder(Address(bucket.url("reel")), pauses=(0.0,))).update()
    faults.left = 0
    assert bucket.keys("reel") == []
    assert Publication(reel, Address(bucket.url("reel"))).update() is not None
    verify_reel(bucket.url("reel"))


def test_readers_find_silent_corruption(faulty: tuple[Bucket, Faults], tmp_path: Any) -> None:
    bucket, _ = faulty
    reel = write_reel(tmp_path / "reel")
    Publication(reel, Address(bucket.url("reel"))).update()
    key = next(key for key in bucket.keys("reel") if key.endswith(".safetensors"))
    data = bytearray(bucket.client.get_object(Bucket=bucket.name, Key=key)["Body"].read())
    data[-1] ^= 1
    bucket.client.put_object(Bucket=bucket.name, Key=key, Body=bytes(data))
    with pytest.raises(ReelError, match=r"SHA-256|checksum|damaged"):
        verify_reel(bucket.url("reel"))
