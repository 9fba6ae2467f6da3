"""The web server of the player: responses, refusals, and shutdown."""

import http.client
import json
import os
import re
import shutil
import socket
import stat
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from urllib.parse import quote, urlsplit

import pytest

from splatreel.base.errors import ReelError, UsageError
from splatreel.codec.preview import write_preview
from splatreel.play.player_page import STATIC
from splatreel.play.presentation_writer import PresentationWriter
from splatreel.play.served_files import RunFiles, ServedFiles
from splatreel.play.server import Server, serve
from tests.codec.reels import edit_manifest, new_header, new_writer, points, write_reel
from tests.golden import GOLDEN
from tests.play.attacks import ATTACKS, GET, GET_LARGE, HEAD, LARGE, large_reel, served

DOCS = Path(__file__).parents[2] / "docs" / "player.md"
DATA = bytes(range(256)) * 8


@pytest.fixture
def reel(tmp_path: Path) -> Path:
    path = tmp_path / "reel"
    shutil.copytree(GOLDEN, path)
    (path / "groups" / "0000.safetensors").write_bytes(DATA)
    (path / "groups" / ".hidden.json").write_text("{}")
    for stray in ("notes.py", "notes.json", "groups/0099.safetensors"):
        (path / stray).write_text("secret")
    (tmp_path / "secret.json").write_text("secret")
    (path / "groups" / "0001.safetensors").unlink()
    (path / "groups" / "0001.safetensors").symlink_to(tmp_path / "secret.json")
    return path


@pytest.fixture
def server(reel: Path):
    with serve(reel, port=0) as running:
        yield running


def request(server: Server, path: str, method: str = "GET", **headers: str) -> tuple[http.client.HTTPResponse, bytes]:
    connection = http.client.HTTPConnection(urlsplit(server.url).netloc, timeout=60)
    try:
        connection.request(method, path, headers={name.replace("_", "-"): value for name, value in headers.items()})
        response = connection.getresponse()
        return response, response.read()
    finally:
        connection.close()


def test_server_serves_player_and_reel(server: Server):
    page, body = request(server, "/")
    assert page.status == 200
    assert page.headers["Content-Type"] == "text/html; charset=utf-8"
    assert b"player.js" in body
    manifest, body = request(server, "/reel/manifest.json?x=1")
    assert json.loads(body) == json.loads((GOLDEN / "manifest.json").read_text())
    assert manifest.headers["X-Content-Type-Options"] == "nosniff"
    assert request(server, "/reel/groups/0000.safetensors")[1] == DATA


@pytest.mark.parametrize(
    ("path", "content_type"),
    [
        ("/player.js", "text/javascript; charset=utf-8"),
        ("/draco_decoder.wasm", "application/wasm"),
        ("/reel/manifest.json", "application/json"),
        ("/reel/groups/0000.safetensors", "application/octet-stream"),
    ],
)
def test_server_content_types(server: Server, path: str, content_type: str):
    assert request(server, path, "HEAD")[0].headers["Content-Type"] == content_type


@pytest.mark.parametrize(
    ("header", "expected", "content_range"),
    [
        ("bytes=0-9", DATA[:10], "bytes 0-9/2048"),
        ("bytes=2000-", DATA[2000:], "bytes 2000-2047/2048"),
        ("bytes=-5", DATA[-5:], "bytes 2043-2047/2048"),
        ("bytes=2040-9999", DATA[2040:], "bytes 2040-2047/2048"),
    ],
)
def test_server_answers_byte_ranges(server: Server, header: str, expected: bytes, content_range: str):
    response, body = request(server, "/reel/groups/0000.safetensors", Range=header)
    assert response.status == 206
    assert body == expected
    assert response.headers["Content-Range"] == content_range


def test_server_refuses_range_beyond_file(server: Server):
    response, _ = request(server, "/reel/groups/0000.safetensors", Range="bytes=2048-")
    assert response.status == 416
    assert response.headers["Content-Range"] == "bytes */2048"


@pytest.mark.parametrize("header", ["bytes=5-2", "bytes=-", "items=0-1", "bytes=0-1,4-5", "bytes=x-"])
def test_server_answers_invalid_ranges_with_whole_file(server: Server, header: str):
    response, body = request(server, "/reel/groups/0000.safetensors", Range=header)
    assert response.status == 200
    assert body == DATA


def test_server_answers_head_and_not_modified(server: Server):
    response, body = request(server, "/reel/manifest.json", "HEAD")
    assert (response.status, body) == (200, b"")
    assert response.headers["Content-Length"] == str((GOLDEN / "manifest.json").stat().st_size)
    again, body = request(server, "/reel/manifest.json", If_None_Match=response.headers["ETag"])
    assert (again.status, body) == (304, b"")
    since, _ = request(server, "/reel/manifest.json", If_Modified_Since=response.headers["Last-Modified"])
    assert since.status == 304
    # A file that was written after the clock was set back has an earlier date.
    later, _ = request(server, "/reel/manifest.json", If_Modified_Since="Fri, 31 Dec 2100 23:59:59 GMT")
    assert later.status == 200


@pytest.mark.parametrize(
    "path",
    [
        "/reel/",
        "/reel",
        "/reel/groups",
        "/reel/groups/",
        "/reel/../secret.json",
        "/reel/%2e%2e/secret.json",
        "/reel/..%2fsecret.json",
        "/reel/groups/../../secret.json",
        "/reel//etc/passwd",
        "/reel/..\\secret.json",
        "/reel/groups/0001.safetensors",  # a link that leaves the reel
        "/reel/notes.py",
        "/reel/notes.json",
        "/reel/groups/0099.safetensors",
        "/reel/groups/.hidden.json",
        "/reel/manifest.json/",
        "/reel/manifest.json%00.html",
        "/reel/%ff",
        "/server.py",
        "/../server.py",
        "/" + "a" * 5000 + ".json",
        "/reel/" + "a" * 5000 + ".json",
        "http://127.0.0.1/reel/manifest.json",
        "/none.html",
    ],
)
def test_server_refuses_other_paths(server: Server, path: str):
    response, body = request(server, path)
    assert response.status == 404
    assert b"secret" not in body


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS", "TRACE", "MADE-UP"])
def test_server_is_read_only(server: Server, method: str):
    response, _ = request(server, "/reel/manifest.json", method)
    assert response.status == 405
    assert response.headers["Allow"] == "GET, HEAD"


@pytest.mark.parametrize("said", [{"Content_Length": "5"}, {"Transfer_Encoding": "chunked"}])
@pytest.mark.parametrize(("method", "status"), [("GET", 413), ("POST", 405)])
def test_server_refuses_request_bodies(server: Server, method: str, status: int, said: dict[str, str]):
    response, _ = request(server, "/reel/manifest.json", method, **said)
    assert (response.status, response.headers["Connection"]) == (status, "close")


def preflight(server: Server) -> http.client.HTTPResponse:
    asked = {"Access_Control_Request_Method": "GET", "Access_Control_Request_Headers": "range"}
    return request(server, "/reel/manifest.json", "OPTIONS", Origin="http://elsewhere", **asked)[0]


def test_server_without_cors_blocks_other_sites(server: Server):
    response, _ = request(server, "/reel/manifest.json", Origin="http://elsewhere")
    assert response.status == 200
    assert "Access-Control-Allow-Origin" not in response.headers
    assert response.headers["Cross-Origin-Resource-Policy"] == "same-origin"
    assert preflight(server).status == 405


def test_server_with_cors_admits_other_sites(reel: Path):
    with serve(reel, port=0, cors=True) as server:
        response, _ = request(server, "/reel/manifest.json", Origin="http://elsewhere")
        asked = preflight(server)
        assert request(server, "/none", Origin="http://elsewhere")[0].headers["Access-Control-Allow-Origin"] == "*"
    assert response.headers["Access-Control-Allow-Origin"] == "*"
    assert response.headers["Cross-Origin-Resource-Policy"] == "cross-origin"
    assert "ETag" in response.headers["Access-Control-Expose-Headers"]
    assert asked.status == 200
    assert "Range" in asked.headers["Access-Control-Allow-Headers"]


def test_files_of_reel_cannot_run_scripts(reel: Path):
    """Its manifest may call a page an image."""
    (reel / "page.html").write_text("<script>alert(1)</script>")
    poster = {"uri": "page.html", "bytes": 25, "sha256": "0" * 64, "width": 1, "height": 1}
    edit_manifest(reel, lambda document: document.update(poster=poster))
    with serve(reel, port=0) as server:
        response, _ = request(server, "/reel/page.html")
    assert response.headers["Content-Type"] == "application/octet-stream"
    assert response.headers["Content-Security-Policy"] == "default-src 'none'"


def test_page_has_documented_content_security_policy(server: Server):
    documented = re.findall(r"^ +Content-Security-Policy: (.+)$", DOCS.read_text(encoding="utf-8"), re.M)[0]
    response, _ = request(server, "/")
    assert response.headers["Referrer-Policy"] == "no-referrer"
    sent = dict(line.split(" ", 1) for line in response.headers["Content-Security-Policy"].split("; "))
    for line in documented.split("; "):
        name, *sources = line.split(" ")
        assert "unsafe-inline" not in sent[name]
        hashed = [source for source in sources if not source.startswith("'sha256-")]
        assert set(hashed) <= set(sent[name].split(" ")), name


@pytest.mark.parametrize(
    ("src", "host"),
    [
        ("https://reels.example/train/manifest.json", "https://reels.example"),
        ("HTTP://reels.example:8080/manifest.json", "HTTP://reels.example:8080"),
        ("//reels.example/manifest.json", "reels.example"),
        ("reel/manifest.json", None),
        ("https://a@reels.example/manifest.json", None),
        ("https://reels.example; script-src *", None),
        ("https://reels.example *", None),
        ("https://*/manifest.json", None),
    ],
)
def test_page_shows_images_of_the_host_of_its_reel_only(server: Server, src: str, host: str | None):
    for page in ("", "self-test.html"):
        response, _ = request(server, f"/{page}?src={quote(src)}")
        sent = dict(line.split(" ", 1) for line in response.headers["Content-Security-Policy"].split("; "))
        assert sent["img-src"].split() == ["'self'", *([host] if host else []), "data:", "blob:"]
        assert "*" not in sent["script-src"]


def test_server_follows_live_manifest(reel: Path):
    whole = (reel / "manifest.json").read_text()
    with serve(reel, port=0) as server:
        assert request(server, "/reel/groups/0000.safetensors")[0].status == 200
        (reel / "next.json").write_text("{")
        (reel / "next.json").replace(reel / "manifest.json")
        assert request(server, "/reel/groups/0000.safetensors")[0].status == 404, "a damaged manifest names nothing"
        assert request(server, "/reel/manifest.json")[1] == b"{"
        (reel / "next.json").write_text(whole)
        (reel / "next.json").replace(reel / "manifest.json")
        assert request(server, "/reel/groups/0000.safetensors")[0].status == 200


def test_shortened_file_closes_connection(server: Server, reel: Path, monkeypatch: pytest.MonkeyPatch):
    """The promised length cannot be kept."""
    monkeypatch.setattr(
        "splatreel.play.web_app.os.fstat",
        lambda _: SimpleNamespace(st_mtime_ns=1, st_mtime=1, st_size=9999, st_mode=stat.S_IFREG),
    )
    with pytest.raises((http.client.IncompleteRead, ConnectionError)):
        request(server, "/reel/groups/0000.safetensors")


def test_server_answers_many_requests_despite_stalled_one(server: Server):
    address = urlsplit(server.url)
    with socket.create_connection((address.hostname, address.port)) as stalled:
        stalled.sendall(b"GET /reel/manifest.json HTTP/1.1\r\n")
        with ThreadPoolExecutor(16) as pool:
            bodies = list(pool.map(lambda _: request(server, "/reel/groups/0000.safetensors")[1], range(100)))
    assert all(body == DATA for body in bodies)


def test_server_listens_on_loopback_by_default(server: Server):
    assert server.url.startswith("http://127.0.0.1:")


def test_close_frees_port(reel: Path):
    server = serve(reel, port=0)
    port = urlsplit(server.url).port
    assert port
    with pytest.raises(UsageError, match=str(port)):
        serve(reel, port=port)
    server.close()
    serve(reel, port=port).close()


def test_invalid_port_raises_usage_error(reel: Path):
    with pytest.raises(UsageError, match=r"127\.0\.0\.1:99999 .*0-65535.*Choose another"):
        serve(reel, port=99999)


def test_folder_without_reel_raises_reel_error(tmp_path: Path):
    with pytest.raises(ReelError, match=r"no manifest\.json"):
        serve(tmp_path, port=0)


def test_unstarted_server_frees_port_on_close(reel: Path):
    server = Server(reel)
    address = urlsplit(server.url)
    server.close()
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection((address.hostname, address.port), timeout=5)


HOSTILE = 'Cats & "dogs" </title><script>alert(1)</script>'


class Head(HTMLParser):
    """Contents of a page's head: title, tags by name or property, and number of scripts."""

    def __init__(self, page: bytes) -> None:
        super().__init__()
        self.title, self.tags, self.scripts, self._open = "", {}, 0, ""
        self.feed(page.decode())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        self._open = tag
        self.scripts += tag == "script"
        if tag == "meta" and "content" in found:
            self.tags[found.get("property") or found.get("name")] = found["content"]

    def handle_data(self, data: str) -> None:
        if self._open == "title":
            self.title += data.strip()

    def handle_endtag(self, tag: str) -> None:
        self._open = ""


def test_page_contains_metadata_of_reel(tmp_path: Path):
    reel = write_reel(tmp_path / "reel", groups=1)
    writer = new_writer(reel, resume=True)
    words = {"title": HOSTILE, "author": "A. Nobody", "description": "'Two' <b>cats</b>"}
    PresentationWriter(words)(writer, None)
    with serve(reel, port=0) as server:
        plain = Head((STATIC / "index.html").read_bytes())
        answer, body = request(server, "/")
        head = Head(body)
        assert head.title == head.tags["og:title"] == HOSTILE
        assert head.scripts == plain.scripts
        assert (head.tags["author"], head.tags["og:description"]) == ("A. Nobody", "'Two' <b>cats</b>")
        assert head.tags["og:image"] == f"{server.url}reel/poster.jpg"
        image, data = request(server, "/reel/poster.jpg")
        assert (image.headers["Content-Type"], data[:2]) == ("image/jpeg", b"\xff\xd8")
        assert request(server, "/", "HEAD")[0].headers["Content-Length"] == str(len(body))
        assert request(server, "/index.html", If_None_Match=answer.headers["ETag"])[0].status == 304
        assert Head(request(server, "/?src=other/manifest.json")[1]).title == plain.title, "it is another reel"
        edit_reel_live(reel, "Other")
        assert Head(request(server, "/", If_None_Match=answer.headers["ETag"])[1]).title == "Other"
    with serve(reel, port=0, allow_hosts=["reels.example"]) as server:
        secure = Head(request(server, "/", Host="reels.example:8443", X_Forwarded_Proto="https")[1])
        assert secure.tags["og:image"] == "https://reels.example:8443/reel/poster.jpg"


def edit_reel_live(reel: Path, title: str) -> None:
    writer = new_writer(reel, resume=True)
    writer.present(replace(writer.manifest.presentation, title=title))


def test_page_of_reel_without_metadata_has_default_title(server: Server, reel: Path):
    """Its manifest is damaged, even: the player says so, not the server."""
    (reel / "manifest.json").write_text('{"format": "splatreel"}')
    assert Head(request(server, "/")[1]).title == "Splatreel"


def test_a_run_is_served_from_its_first_preview_on(tmp_path: Path):
    files = RunFiles(tmp_path)
    with pytest.raises(ReelError, match="is not a reel"):
        Server(tmp_path)
    with Server(files, reels={"sample": ServedFiles(GOLDEN)}) as server:
        assert not files.shows
        assert request(server, "/reel/manifest.json")[0].status == 404
        assert request(server, "/sample/manifest.json")[1] == (GOLDEN / "manifest.json").read_bytes()
        assert request(server, "/sample/../reel/manifest.json")[0].status == 404
        for count in (10, 20):
            preview = write_preview(tmp_path, new_header(), None, points(count))
            assert files.shows
            assert request(server, "/reel/manifest.json")[1] == (preview / "manifest.json").read_bytes()
            name = "layers/0000.safetensors"
            assert request(server, f"/reel/{name}")[1] == (preview / name).read_bytes()
        with Server(tmp_path) as other:
            assert request(other, "/reel/manifest.json")[0].status == 200
        write_reel(tmp_path / "reel")
        assert request(server, "/reel/manifest.json")[1] == (tmp_path / "reel" / "manifest.json").read_bytes()


@pytest.fixture
def golden_server() -> Iterator[Server]:
    with serve(GOLDEN, port=0) as running:
        yield running


def dial(server: Server) -> socket.socket:
    address = urlsplit(server.url)
    return socket.create_connection((address.hostname, address.port), timeout=120)


def received(peer: socket.socket) -> bytes:
    """All that comes until the server closes the connection."""
    data = b""
    try:
        while chunk := peer.recv(1 << 16):
            data += chunk
    except ConnectionError:
        pass
    return data


def shorten(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    monkeypatch.setattr(f"splatreel.play.server.{name}", 0.3)


def test_slow_headers_time_out(golden_server: Server, monkeypatch: pytest.MonkeyPatch):
    shorten(monkeypatch, "REQUEST_SECONDS")
    with dial(golden_server) as peer:
        try:
            for byte in HEAD * 100:
                peer.sendall(bytes([byte]))
                time.sleep(0.02)
        except ConnectionError:
            return
    pytest.fail("it was not given up")


def test_slow_second_request_times_out(golden_server: Server, monkeypatch: pytest.MonkeyPatch):
    shorten(monkeypatch, "REQUEST_SECONDS")
    monkeypatch.setattr("splatreel.play.server.IDLE_SECONDS", 1000)
    with dial(golden_server) as peer:
        peer.sendall(GET + HEAD)
        assert received(peer).count(b"HTTP/1.1 200") == 1  # it ends: else this times out


def test_idle_connection_times_out(golden_server: Server, monkeypatch: pytest.MonkeyPatch):
    shorten(monkeypatch, "IDLE_SECONDS")
    with dial(golden_server) as peer:
        peer.sendall(GET)
        assert received(peer).startswith(b"HTTP/1.1 200")


def test_stalled_reader_times_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    shorten(monkeypatch, "STALL_SECONDS")
    reel = large_reel(tmp_path)
    with serve(reel, port=0) as server, dial(server) as peer:
        peer.sendall(GET_LARGE)
        time.sleep(4)
        assert len(received(peer)) < LARGE, "it was cut off"


def test_slow_reader_receives_everything(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Longer than a reader may stall in all, but never at once."""
    monkeypatch.setattr("splatreel.play.server.STALL_SECONDS", 2.0)
    reel, size = large_reel(tmp_path), 0
    with serve(reel, port=0) as server:
        peer = dial(server)
        with peer:
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 16)
            peer.sendall(GET_LARGE[:-2] + b"Connection: close\r\n\r\n")
            while chunk := peer.recv(1 << 19):
                size += len(chunk)
                time.sleep(len(chunk) / (8 << 20))
    assert size > LARGE


@pytest.mark.parametrize("count", [2, 3, 20_000])
def test_connection_answers_two_pipelined_requests_and_closes(golden_server: Server, count: int):
    """Then the connection ends; those who send them so must be ready to send the others again."""
    with dial(golden_server) as peer:
        with suppress(ConnectionError):
            peer.sendall(GET * count)
        answers = received(peer).count(b"HTTP/1.1 200")
    assert answers == 2 or (count > 3 and answers < 2), "what is unread when a connection ends takes answers with it"


def test_connection_answers_sequential_requests(golden_server: Server):
    address = urlsplit(golden_server.url)
    asking = http.client.HTTPConnection(address.netloc, timeout=120)
    asking.connect()
    first = asking.sock
    for _ in range(50):
        asking.request("GET", "/reel/manifest.json")
        assert asking.getresponse().read() == (GOLDEN / "manifest.json").read_bytes()
    assert asking.sock is first
    asking.close()


def test_new_connection_replaces_longest_waiting_one(golden_server: Server):
    """The connection that waited longest is given up, not the newest."""
    with ExitStack() as stack:
        for _ in range(300):
            stack.enter_context(dial(golden_server)).sendall(HEAD)
        assert request(golden_server, "/reel/manifest.json")[0].status == 200


def test_connection_limit_keeps_active_readers(golden_server: Server):
    with dial(golden_server) as peer, ExitStack() as stack:
        peer.sendall(GET)
        assert peer.recv(1 << 16).startswith(b"HTTP/1.1 200")
        for _ in range(200):
            stack.enter_context(dial(golden_server)).sendall(HEAD)
        peer.sendall(HEAD + b"Connection: close\r\n\r\n")
        assert b"HTTP/1.1 200" in received(peer)


@pytest.mark.skipif(not os.path.exists("/proc/self/status"), reason="memory is read from /proc")
def test_attacks_use_little_memory_and_cause_no_delay(tmp_path: Path):
    with served(large_reel(tmp_path)) as victim:
        before = victim.peak()
        for attack in ATTACKS:
            with ExitStack() as stack:
                for peer in attack(victim.address):
                    stack.enter_context(peer)
                assert min(victim.ask() for _ in range(3)) < 10, attack.__name__
            assert victim.peak() - before < 100e6, attack.__name__


def test_server_closes_at_once_despite_open_connections(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    for name in ("REQUEST_SECONDS", "IDLE_SECONDS", "STALL_SECONDS"):
        monkeypatch.setattr(f"splatreel.play.server.{name}", 1000)
    server = serve(large_reel(tmp_path), port=0)
    with ExitStack() as stack:
        for sent in (b"", HEAD, GET, GET_LARGE):
            stack.enter_context(dial(server)).sendall(sent)
        time.sleep(0.2)
        closing = threading.Thread(target=server.close)
        closing.start()
        closing.join(120)
        assert not closing.is_alive()
