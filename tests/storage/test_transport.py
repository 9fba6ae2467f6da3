"""Meaning of the errors of the libraries that reach files."""

import errno
import socket
import ssl
import urllib.error
from email.message import Message
from http.client import BadStatusLine, IncompleteRead, InvalidURL, RemoteDisconnected
from typing import Any

import pytest

from splatreel.storage.transport import Verdict, judge


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
