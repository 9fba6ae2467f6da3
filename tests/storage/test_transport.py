"""Meaning of the errors of the libraries that reach files."""

from __future__ import annotations

import errno
import socket
import ssl
import urllib.error
from email.message import Message
from http.client import BadStatusLine, IncompleteRead, InvalidURL, RemoteDisconnected
from typing import Any

import pytest

from splatreel.base.errors import ReelError, StorageError
from splatreel.codec.inspection import verify_reel
from splatreel.codec.publish import Publication
from splatreel.storage.address import Address
from splatreel.storage.transport import Verdict, judge
from tests.buckets import Bucket, Faults
from tests.codec.reels import write_reel


def http_error(status: int) -> urllib.error.HTTPError:
    return urllib.error.HTTPError("http://host/file", status, "in words", Message(), None)


def made(kind: str, **values: Any) -> Exception:
    """Return an error of another library, with its attributes."""
    error = type(kind, (Exception,), {})("in words")
    vars(error).update(values)
    return error


def of_boto(status: int, code: str, kind: type[Exception] = OSError, *arguments: Any) -> Exception:
    """Return an error of s3fs, whose cause is one of botocore."""
    error = kind(*arguments, "in words")
    response = {"Error": {"Code": code}, "ResponseMetadata": {"HTTPStatusCode": status}}
    error.__cause__ = made("ClientError", response=response)
    return error


PASSING = [
    *map(http_error, (408, 425, 429, 500, 502, 503, 504)),
    urllib.error.URLError(ConnectionRefusedError(errno.ECONNREFUSED, "refused")),
    urllib.error.URLError(socket.gaierror(socket.EAI_AGAIN, "no connection")),
    *(
        TimeoutError("timed out"),
        RemoteDisconnected("?"),
        IncompleteRead(b""),
        BadStatusLine("?"),
        ssl.SSLEOFError(8, "EOF"),
    ),
    *(OSError(errno.EHOSTUNREACH, "unreachable"), OSError(errno.EIO, "input/output")),
    of_boto(503, "SlowDown", OSError, errno.EBUSY),
    of_boto(500, "InternalError", OSError, errno.EIO),
    of_boto(400, "IncompleteBody", OSError, errno.EINVAL),
    of_boto(400, "RequestTimeout", TimeoutError),
    made("HttpError", code=503),
    made("ServiceRequestError"),
    made("HttpResponseError", status_code=500),
    made("ClientResponseError", status=502),
    made("EndpointConnectionError"),
]
REFUSED = [
    *map(http_error, (401, 403)),
    PermissionError(errno.EACCES, "denied"),
    of_boto(403, "AccessDenied", PermissionError),
    made("NoCredentialsError"),
    made("DefaultCredentialsError"),
    made("ClientAuthenticationError"),
    made("AuthenticationException"),
    made("HttpError", code=401),
]
MISSING = [
    *map(http_error, (404, 410)),
    FileNotFoundError(errno.ENOENT, "no file"),
    of_boto(404, "NoSuchBucket", FileNotFoundError),
    made("ResourceNotFoundError", status_code=404),
]
LASTING = [
    *map(http_error, (400, 405, 409, 418)),
    urllib.error.URLError(ssl.SSLCertVerificationError("self-signed")),
    urllib.error.URLError(socket.gaierror(socket.EAI_NONAME, "no such host")),
    *(OSError(errno.ENOSPC, "full"), OSError(errno.EROFS, "read-only"), NotADirectoryError(errno.ENOTDIR, "a file")),
    *(InvalidURL("no port"), ValueError("no value"), NotImplementedError()),
    of_boto(400, "InvalidArgument", OSError, errno.EINVAL),
]


@pytest.mark.parametrize(
    ("error", "verdict"),
    [
        (error, verdict)
        for verdict, errors in (
            (Verdict.PASSING, PASSING),
            (Verdict.REFUSED, REFUSED),
            (Verdict.MISSING, MISSING),
            (Verdict.LASTING, LASTING),
        )
        for error in errors
    ],
    ids=repr,
)
def test_errors_are_judged(error: Exception, verdict: Verdict) -> None:
    assert judge(error) is verdict


def test_code_of_aiohttp_for_an_invalid_response_is_no_status() -> None:
    exceptions = pytest.importorskip("aiohttp.http_exceptions")
    error = ConnectionError("payload")
    error.__cause__ = exceptions.ContentLengthError("cut")
    assert judge(error) is Verdict.PASSING


@pytest.mark.parametrize(("fault", "times"), [("fails", 2), ("is_slow", 100), ("cuts", 2), ("tags_wrongly", 100)])
def test_publication_is_complete_after_s3_faults(
    faulty: tuple[Bucket, Faults], tmp_path: Any, fault: str, times: int
) -> None:
    bucket, faults = faulty
    reel = write_reel(tmp_path / "reel")
    faults.begin(fault, left=times)
    there = Address(bucket.url("reel"), pauses=(0.0, 0.0, 0.0, 0.0))
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
    faults.begin("fails", left=1000)
    with pytest.raises(StorageError, match="could not be written"):
        Publication(reel, Address(bucket.url("reel"), pauses=(0.0,))).update()
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


@pytest.fixture
def stored(faulty: tuple[Bucket, Faults], tmp_path: Any) -> tuple[str, int]:
    """Return the address of a reel in the bucket, and the number of its files."""
    address = faulty[0].url("reel")
    published = Publication(write_reel(tmp_path / "reel"), Address(address)).update()
    assert published is not None
    return address, published.files + 1


@pytest.mark.parametrize("fault", ["is_busy", "fails", "cuts", "ignores_ranges"])
def test_reel_is_complete_though_each_first_request_fails(
    faulty: tuple[Bucket, Faults], stored: tuple[str, int], fault: str
) -> None:
    faults = faulty[1]
    faults.begin(fault, ("GET",))
    verify_reel(stored[0])
    assert faults.met == stored[1]


def test_private_bucket_is_explained_and_not_asked_again(
    faulty: tuple[Bucket, Faults], stored: tuple[str, int]
) -> None:
    faults = faulty[1]
    faults.begin("is_private", ("GET", "PUT"), 100)
    with pytest.raises(ReelError, match=r"manifest\.json: cannot be read \(.*is private.*AWS_ACCESS_KEY_ID") as caught:
        verify_reel(stored[0])
    assert "docs/publishing.md" in str(caught.value)
    assert faults.met == 1
    for act in (Address(stored[0]).sizes, lambda: Address(stored[0]).write("a", b"1")):
        with pytest.raises(StorageError, match="is private") as refused:
            act()
        assert refused.value.lasting
    assert faults.met == 3


@pytest.mark.parametrize("fault", ["is_busy", "fails"])
def test_listing_is_retried(faulty: tuple[Bucket, Faults], stored: tuple[str, int], fault: str) -> None:
    faults = faulty[1]
    faults.begin(fault, ("GET",), 2)
    assert len(Address(stored[0]).sizes()) == stored[1]
    assert faults.left is not None
    assert faults.left < 0


@pytest.mark.parametrize("fault", ["is_busy", "ignores_ranges"])
def test_parts_of_a_file_are_exact(faulty: tuple[Bucket, Faults], fault: str) -> None:
    bucket, faults = faulty
    address = Address(bucket.url("files"))
    address.write("a", bytes(range(200)))
    address.write("empty", b"")
    faults.begin(fault, ("GET",))
    assert address.read_range("a", 20, 30) == bytes(range(20, 30))
    assert address.open("a", 200).read() == bytes(range(200))
    assert address.read("empty", 10) == b""
    assert faults.met
    with pytest.raises(StorageError, match="ended after 10 of 20 bytes"):
        address.read_range("a", 190, 210)
