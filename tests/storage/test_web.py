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

from splatreel.base.errors import ReelError, StorageError, UsageError
from splatreel.codec.inspection import verify_reel
from splatreel.codec.reader import ReelReader, reel_address
from splatreel.storage.address import Address
from splatreel.storage.web import _SameHost
from tests.buckets import web_server
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


@pytest.fixture(autouse=True)
def short_pauses(monkeypatch):
    """Retry at once."""
    monkeypatch.setattr("splatreel.storage.address.PAUSES", (0.0, 0.0, 0.0))


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
    monkeypatch.setattr("splatreel.storage.web.PATIENCE", -1.0)
    with pytest.raises(ReelError, match=r"pages/0000\d+\.json: was not requested"):
        ReelReader(LONG)
    monkeypatch.setattr("splatreel.storage.web.PATIENCE", 60.0)
    assert len(ReelReader(LONG).manifest.pages) == 4


def test_missing_reel_is_named(url):
    with pytest.raises(ReelError, match=r"http://.*/nothing/manifest\.json: does not exist"):
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
    split, request = urlsplit(asked), urllib.request.Request(asked)
    handler = _SameHost(split.scheme, split.netloc, ReelError)
    if said is None:
        assert handler.redirect_request(request, io.BytesIO(), 302, "Found", HTTPMessage(), newurl).full_url == newurl
    else:
        with pytest.raises(ReelError, match=said):
            handler.redirect_request(request, io.BytesIO(), 302, "Found", HTTPMessage(), newurl)


def test_unreachable_server_is_an_error():
    with pytest.raises(ReelError, match="cannot be read"):
        ReelReader("http://127.0.0.1:9/reel")


@pytest.fixture
def stored(bucket):
    """Return the golden reel in a bucket under its own names."""
    return bucket.upload(GOLDEN, "a")


@pytest.mark.parametrize("end", ["", "/", "/manifest.json"])
def test_reel_is_read_from_a_bucket(stored, end):
    assert verify_reel(f"{stored}{end}") == dataclasses.replace(verify_reel(GOLDEN), strangers=[])


def test_file_url_is_a_path(tmp_path):
    reel = shutil.copytree(GOLDEN, tmp_path / "a reel")
    assert verify_reel(reel.as_uri()).points == verify_reel(GOLDEN).points
    with pytest.raises(ReelError, match="three slashes"):
        reel_address("file://host/reel")


def test_missing_reel_in_a_bucket_is_named(bucket):
    with pytest.raises(ReelError, match=r"s3://.*/nothing/manifest\.json: does not exist"):
        ReelReader(bucket.url("nothing"))


def test_missing_bucket_is_an_error(bucket):
    with pytest.raises(ReelError, match=r"s3://no-such-bucket/reel/manifest\.json: does not exist"):
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
    address = reel_address(places[where]())
    with pytest.raises(ReelError, match="longer than the 10 bytes"):
        address.fetch("manifest.json", 10)


def test_slow_server_hits_the_deadline(url, monkeypatch):
    monkeypatch.setattr("splatreel.storage.web.PATIENCE", -1.0)
    with pytest.raises(ReelError, match="cannot be read"):
        ReelReader(f"{url}/golden")


def test_slow_response_header_hits_the_deadline(monkeypatch):
    """A server that sends a byte of the header now and then never exceeds the socket timeout."""
    monkeypatch.setattr("splatreel.storage.web.HEAD", 0.5)
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
        with pytest.raises(ReelError, match="cannot be read"):
            ReelReader(f"http://127.0.0.1:{server.getsockname()[1]}/reel")
        assert len(sent) < most


@pytest.mark.parametrize("address", ["http://[", "http://host:port/reel", "http://host:99999999/"])
def test_invalid_url_is_refused(address):
    with pytest.raises(ReelError, match=r"is not an address|cannot be read"):
        ReelReader(address)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes")
@pytest.mark.parametrize("uri", ["manifest.json", "groups/0000.safetensors"])
def test_pipe_in_a_reel_does_not_block(tmp_path, uri):
    reel = shutil.copytree(GOLDEN, tmp_path / "reel")
    (reel / uri).unlink()
    os.mkfifo(reel / uri)
    with pytest.raises(ReelError, match=f"{uri}: is a pipe or a device"):
        ReelReader(reel).group(0)


@pytest.mark.parametrize("fault", [503, 500, 408, 429, "cuts", "hangs up"])
def test_reel_is_complete_though_each_first_request_fails(fault, caplog):
    with web_server(GOLDEN.parent, fault) as (server, asked):
        assert verify_reel(f"{server}/golden").points == verify_reel(GOLDEN).points
        files = len(ReelReader(GOLDEN).manifest.uris) + 1
        assert sum("Retrying." in line for line in caplog.messages) == files == len(set(asked))


def test_retries_end_and_are_logged(caplog):
    with web_server(GOLDEN.parent, 503, always=True) as (server, asked):
        with pytest.raises(ReelError, match=r"manifest\.json: cannot be read \(HTTP Error 503: .*try again\."):
            ReelReader(f"{server}/golden")
        assert len(asked) == 4
    assert len(caplog.messages) == 3
    assert caplog.messages[0].endswith("Retrying.")


@pytest.mark.parametrize(
    ("status", "words"),
    [
        (403, r"HTTP Error 403.*is private.*credentials, such as s3://BUCKET/REEL"),
        (401, r"HTTP Error 401.*is private"),
        (404, r"golden/manifest\.json: does not exist"),
        (410, r"golden/manifest\.json: does not exist"),
        (400, r"HTTP Error 400.*Check the address"),
        (418, r"HTTP Error 418.*Check the address"),
    ],
)
def test_refusals_are_explained_and_not_retried(status, words, caplog):
    with web_server(GOLDEN.parent, status, always=True) as (server, asked):
        with pytest.raises(ReelError, match=words):
            ReelReader(f"{server}/golden")
        assert len(asked) == 1
    assert caplog.messages == []


def test_interrupt_ends_the_retries():
    def interrupt(seconds):
        raise KeyboardInterrupt

    with web_server(GOLDEN.parent, 503, always=True) as (server, asked):
        with pytest.raises(KeyboardInterrupt):
            Address(server, wait=interrupt).read("golden/manifest.json", 10)
        assert len(asked) == 1


class _Ranges(http.server.BaseHTTPRequestHandler):
    """Handler that sends the requested range of a text, or with /wrong/ another one."""

    def do_GET(self):
        begin, end = map(int, self.headers["Range"].removeprefix("bytes=").split("-"))
        begin += "/wrong/" in self.path
        data = b"0123456789"[begin : end + 1]
        self.send_response(206 if data else 416)
        self.send_header("Content-Range", f"bytes {begin}-{begin + len(data) - 1}/10" if data else "bytes */10")
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, format, *arguments):
        pass


def test_ranges_are_read_from_servers_with_and_without_ranges(tmp_path):
    (tmp_path / "file").write_bytes(b"0123456789")
    with web_server(tmp_path) as (server, _):
        address = Address(server)
        assert address.read_range("file", 3, 7) == b"3456"
        assert address.read_range("file", 0, 4) == b"0123"
        assert address.read("file", 100) == b"0123456789"
        assert address.open("file", 10).read() == b"0123456789"
        with pytest.raises(StorageError, match="ended after 2 of 4 bytes"):
            address.read_range("file", 8, 12)
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), _Ranges)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    address = Address(f"http://127.0.0.1:{server.server_port}")
    assert address.read_range("file", 3, 7) == b"3456"
    with pytest.raises(StorageError, match="ended after 0 of 5 bytes"):
        address.read_range("file", 15, 20)
    with pytest.raises(StorageError, match="another part"):
        address.read_range("wrong/file", 3, 7)
    server.shutdown()
    server.server_close()


def test_signature_goes_to_every_file_and_is_not_shown():
    with web_server(GOLDEN.parent) as (server, asked):
        host = server.removeprefix("http://")
        assert verify_reel(f"http://me:secret@{host}/golden/manifest.json?sig=abc").groups == 2
        assert all(path.endswith("?sig=abc") for path in asked)
        with pytest.raises(ReelError) as caught:
            ReelReader(f"http://me:secret@{host}/nothing?sig=abc")
    assert str(caught.value).startswith(f"http://***@{host}/nothing/manifest.json: does not exist")


def test_web_servers_neither_list_nor_take_files(url):
    with pytest.raises(UsageError, match="do not list their files"):
        Address(url).sizes()
    for act in (lambda: Address(url).write("a", b""), lambda: Address(url).remove("a")):
        with pytest.raises(UsageError, match="take no files"):
            act()
