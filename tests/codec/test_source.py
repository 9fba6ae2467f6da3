"""Reels over HTTP: the same as from disk, and no way out of the host."""

import dataclasses
import functools
import http.server
import threading

import pytest

from splatreel.codec.reader import ReelReader
from splatreel.codec.source import open_source
from splatreel.codec.verify import verify_reel
from splatreel.errors import ReelError
from tests.golden import GOLDEN


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
def test_over_http(url, end):
    assert ReelReader(f"{url}/golden{end}").manifest.to_json() == ReelReader(GOLDEN).manifest.to_json()


def test_whole_reel_over_http(url):
    here = verify_reel(GOLDEN)
    assert here.strangers == ["expected.json", "expected.npz"]
    assert verify_reel(f"{url}/golden") == dataclasses.replace(
        here, strangers=[]
    )  # a server does not say what else it has


def test_missing_reel(url):
    with pytest.raises(ReelError, match=r"http://.*manifest\.json: cannot be fetched \(HTTP Error 404"):
        ReelReader(f"{url}/nothing")


def test_redirect_to_another_host(url):
    with pytest.raises(ReelError, match="another host"):
        ReelReader(f"{url}/elsewhere/")


def test_nobody_answers():
    with pytest.raises(ReelError, match="cannot be fetched"):
        ReelReader("http://127.0.0.1:9/reel")


@pytest.mark.parametrize("where", ["disk", "web"])
def test_longer_than_allowed(url, where):
    source = open_source(GOLDEN if where == "disk" else f"{url}/golden")
    with pytest.raises(ReelError, match="longer than the 10 bytes"):
        source.read("manifest.json", 10)


def test_a_server_that_trickles(url, monkeypatch):
    monkeypatch.setattr("splatreel.codec.source.PATIENCE", -1.0)
    with pytest.raises(ReelError, match="cannot be fetched"):
        ReelReader(f"{url}/golden")
