"""Reels over HTTP equal those on disk, and no request leaves the host."""

import contextlib
import dataclasses
import functools
import http.server
import io
import os
import shutil
import socket
import threading
import time
import urllib.request
from http.client import HTTPMessage
from urllib.parse import urlsplit

import pytest

from splatreel.base.errors import ReelError
from splatreel.codec.reader import ReelReader
from splatreel.codec.source import _SameHost, open_source
from splatreel.codec.verification import verify_reel
from tests.golden import GOLDEN
from tests.golden_long import LONG, WINDOW


class _Handler(http.server.SimpleHTTPRequestHandler):
    def do_GET(self):
        if self.path.startswith("/elsewhere/"):
            self.send_response(302)
            self.send_header("Location", "http://example.invalid/manifest.json")
            self.end_headers()
        else:
            super().do_GET()

    def log_message(self, format, *arguments):
        pass


@pytest.fixture(scope="module")
def url():
    handler = functools.partial(_Handler, directory=str(GOLDEN.parent))
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()


@pytest.mark.parametrize("end", ["", "/", "/manifest.json"])
def test_files_are_read_over_http(url, end):
    assert ReelReader(f"{url}/golden{end}").manifest.to_json() == ReelReader(GOLDEN).manifest.to_json()


def test_reel_is_read_over_http(url):
    here = verify_reel(GOLDEN)
    assert here.strangers == ["expected.json", "expected.npz"]
    # A server does not say what else it has.
    assert verify_reel(f"{url}/golden") == dataclasses.replace(here, strangers=[])


def test_paged_reel_is_read_over_http(url):
    assert verify_reel(f"{url}/golden-long").groups == 10
    assert ReelReader(f"{url}/golden-window").manifest.layers == ReelReader(WINDOW).manifest.layers


def test_slow_pages_share_a_deadline(monkeypatch):
    monkeypatch.setattr("splatreel.codec.source.PATIENCE", -1.0)
    with pytest.raises(ReelError, match=r"pages/0000\d+\.json: was not requested"):
        ReelReader(LONG)
    monkeypatch.setattr("splatreel.codec.source.PATIENCE", 60.0)
    assert len(ReelReader(LONG).manifest.pages) == 4


def test_missing_reel_is_named(url):
    with pytest.raises(ReelError, match=r"http://.*manifest\.json: cannot be fetched \(HTTP Error 404"):
        ReelReader(f"{url}/nothing")


def test_redirect_to_another_host_is_refused(url):
    with pytest.raises(ReelError, match="another host"):
        ReelReader(f"{url}/elsewhere/")


@pytest.mark.parametrize(
    ("asked", "newurl", "said"),
    [
        ("https://a.example/reel/", "http://a.example/reel/manifest.json", "redirects from HTTPS"),
        ("https://a.example/reel/", "https://b.example/manifest.json", "another host"),
        ("http://a.example/reel/", "http://a.example/there/manifest.json", None),
        ("http://a.example/reel/", "https://a.example/reel/manifest.json", None),
        ("https://a.example/reel/", "https://a.example/there/manifest.json", None),
    ],
)
def test_redirect_from_https_to_http_is_refused(asked, newurl, said):
    handler, request = _SameHost(*urlsplit(asked)[:2]), urllib.request.Request(asked)
    if said is None:
        assert handler.redirect_request(request, io.BytesIO(), 302, "Found", HTTPMessage(), newurl).full_url == newurl
    else:
        with pytest.raises(ReelError, match=said):
            handler.redirect_request(request, io.BytesIO(), 302, "Found", HTTPMessage(), newurl)


def test_unreachable_server_is_an_error():
    with pytest.raises(ReelError, match="cannot be fetched"):
        ReelReader("http://127.0.0.1:9/reel")


@pytest.fixture
def stored(bucket):
    """Return the golden reel in a bucket under its own names."""
    for path in GOLDEN.rglob("*.*"):
        bucket.client.put_object(Bucket=bucket.name, Key=f"a/{path.relative_to(GOLDEN)}", Body=path.read_bytes())
    return bucket.url("a")


@pytest.mark.parametrize("end", ["", "/", "/manifest.json"])
def test_reel_is_read_from_a_bucket(stored, end):
    assert verify_reel(f"{stored}{end}") == dataclasses.replace(verify_reel(GOLDEN), strangers=[])


def test_file_url_is_a_path(tmp_path):
    reel = shutil.copytree(GOLDEN, tmp_path / "a reel")
    assert verify_reel(reel.as_uri()).points == verify_reel(GOLDEN).points
    with pytest.raises(ReelError, match="three slashes"):
        open_source("file://host/reel")


def test_missing_reel_in_a_bucket_is_named(bucket):
    with pytest.raises(ReelError, match=r"s3://.*/nothing/manifest\.json: cannot be fetched \(it is not there\)"):
        ReelReader(bucket.url("nothing"))


def test_missing_bucket_is_an_error(bucket):
    with pytest.raises(ReelError, match=r"s3://no-such-bucket/reel/manifest\.json: cannot be"):
        ReelReader("s3://no-such-bucket/reel")


def test_unknown_protocol_is_refused():
    pytest.importorskip("fsspec", reason="needs the extra cloud")
    with pytest.raises(ReelError, match=r"nix://a/b: is not the address of a folder"):
        ReelReader("nix://a/b")


@pytest.mark.parametrize("where", ["disk", "web", "bucket"])
def test_too_long_file_is_refused(url, where, request):
    places = {
        "disk": lambda: GOLDEN,
        "web": lambda: f"{url}/golden",
        "bucket": lambda: request.getfixturevalue("stored"),
    }
    source = open_source(places[where]())
    with pytest.raises(ReelError, match="longer than the 10 bytes"):
        source.read("manifest.json", 10)


def test_slow_server_hits_the_deadline(url, monkeypatch):
    monkeypatch.setattr("splatreel.codec.source.PATIENCE", -1.0)
    with pytest.raises(ReelError, match="cannot be fetched"):
        ReelReader(f"{url}/golden")


def test_slow_response_header_hits_the_deadline(monkeypatch):
    """A server that sends a byte of the header now and then never exceeds the socket timeout."""
    monkeypatch.setattr("splatreel.codec.source.HEAD", 0.5)
    sent, most = [], 2400  # two minutes of it
    with socket.create_server(("127.0.0.1", 0)) as server:

        def trickle():
            connection, _ = server.accept()
            with connection, contextlib.suppress(OSError):
                connection.sendall(b"HTTP/1.1 200 OK\r\nX: ")
                for number in range(most):
                    connection.sendall(b"x")
                    sent.append(number)
                    time.sleep(0.05)

        threading.Thread(target=trickle, daemon=True).start()
        with pytest.raises(ReelError, match="cannot be fetched"):
            ReelReader(f"http://127.0.0.1:{server.getsockname()[1]}/reel")
        assert len(sent) < most


@pytest.mark.parametrize("address", ["http://[", "http://host:port/reel", "http://host:99999999/"])
def test_invalid_url_is_refused(address):
    with pytest.raises(ReelError, match=r"is not an address|cannot be fetched"):
        ReelReader(address)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes")
@pytest.mark.parametrize("uri", ["manifest.json", "groups/0000.safetensors"])
def test_pipe_in_a_reel_does_not_block(tmp_path, uri):
    reel = shutil.copytree(GOLDEN, tmp_path / "reel")
    (reel / uri).unlink()
    os.mkfifo(reel / uri)
    with pytest.raises(ReelError, match=f"{uri}: is not a file"):
        ReelReader(reel).group(0)
