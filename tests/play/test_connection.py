"""The web server under attack: what others hold open, send too much of, or do not read takes little memory and delays nobody."""

import http.client
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from splatreel.play import connection
from splatreel.play.server import Server, serve
from tests.golden import GOLDEN

HEAD = b"GET /reel/manifest.json HTTP/1.1\r\nHost: localhost\r\n"


@pytest.fixture
def server() -> Iterator[Server]:
    with serve(GOLDEN, port=0) as running:
        yield running


def dial(server: Server) -> socket.socket:
    address = urlsplit(server.url)
    return socket.create_connection((address.hostname, address.port), timeout=10)


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
    monkeypatch.setattr(connection, name, 0.3)


def test_headers_that_are_dribbled_are_given_up(server: Server, monkeypatch: pytest.MonkeyPatch):
    shorten(monkeypatch, "REQUEST_SECONDS")
    begun = time.monotonic()
    with dial(server) as peer:
        try:
            for byte in HEAD * 100:
                peer.sendall(bytes([byte]))
                time.sleep(0.02)
        except ConnectionError:
            assert time.monotonic() - begun < 5
            return
    pytest.fail("it was not given up")


def test_the_second_request_must_come_whole_as_well(server: Server, monkeypatch: pytest.MonkeyPatch):
    shorten(monkeypatch, "REQUEST_SECONDS")
    with dial(server) as peer:
        peer.sendall(HEAD + b"\r\n" + HEAD)
        begun = time.monotonic()
        assert received(peer).count(b"HTTP/1.1 200") == 1
    assert time.monotonic() - begun < 5


def test_who_asks_for_nothing_is_given_up(server: Server, monkeypatch: pytest.MonkeyPatch):
    shorten(monkeypatch, "IDLE_SECONDS")
    with dial(server) as peer:
        peer.sendall(HEAD + b"\r\n")
        assert received(peer).startswith(b"HTTP/1.1 200")


def test_who_does_not_read_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    shorten(monkeypatch, "STALL_SECONDS")
    reel = large_reel(tmp_path)
    with serve(reel, port=0) as server, dial(server) as peer:
        peer.sendall(HEAD.replace(b"manifest.json", b"groups/0000.safetensors") + b"\r\n")
        time.sleep(1.5)
        assert len(received(peer)) < LARGE, "it was cut off"


def test_who_reads_slowly_gets_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Longer than a reader may stall in all, but never at once."""
    shorten(monkeypatch, "STALL_SECONDS")
    reel, size = large_reel(tmp_path), 0
    with serve(reel, port=0) as server:
        peer = dial(server)
        with peer:
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 16)
            peer.sendall(HEAD.replace(b"manifest.json", b"groups/0000.safetensors") + b"Connection: close\r\n\r\n")
            while chunk := peer.recv(1 << 19):
                size += len(chunk)
                time.sleep(len(chunk) / (8 << 20))
    assert size > LARGE


def test_requests_one_after_the_other_in_one_go_are_all_answered(server: Server):
    with dial(server) as peer:
        peer.sendall((HEAD + b"\r\n") * 20 + HEAD + b"Connection: close\r\n\r\n")
        assert received(peer).count(b"HTTP/1.1 200") == 21


def test_there_is_room_for_who_comes_last(server: Server):
    """The connection that waited longest is given up, not the newest."""
    with ExitStack() as stack:
        for _ in range(300):
            stack.enter_context(dial(server)).sendall(HEAD)
        assert quickest(server) < 1


def test_it_is_readers_that_are_kept_where_there_are_too_many(server: Server):
    with dial(server) as peer, ExitStack() as stack:
        peer.sendall(HEAD + b"\r\n")
        assert peer.recv(1 << 16).startswith(b"HTTP/1.1 200")
        for _ in range(200):
            stack.enter_context(dial(server)).sendall(HEAD)
        peer.sendall(HEAD + b"Connection: close\r\n\r\n")
        assert b"HTTP/1.1 200" in received(peer)


LARGE = 24 << 20


def large_reel(folder: Path) -> Path:
    """One whose first group's file is large; nobody but the server reads it."""
    reel = folder / "reel"
    (reel / "groups").mkdir(parents=True)
    (reel / "manifest.json").write_bytes((GOLDEN / "manifest.json").read_bytes())
    with (reel / "groups" / "0000.safetensors").open("wb") as file:
        file.truncate(LARGE)
    return reel


def quickest(server: Server) -> float:
    """Seconds for one request on a connection of its own, the best of three: the machine may be busy."""
    return min(ask(urlsplit(server.url).netloc) for _ in range(3))


def ask(address: str) -> float:
    begun = time.monotonic()
    asking = http.client.HTTPConnection(address, timeout=10)
    asking.request("GET", "/reel/manifest.json")
    assert asking.getresponse().read() == (GOLDEN / "manifest.json").read_bytes()
    asking.close()
    return time.monotonic() - begun


def big_headers(address: tuple[str, int], stack: ExitStack) -> None:
    """As many bytes as the server takes, at most 6 MB a connection."""
    line = b"x: " + b"y" * 60_000 + b"\r\n"
    for _ in range(60):
        peer = stack.enter_context(socket.create_connection(address))
        peer.settimeout(1)
        try:
            peer.sendall(HEAD)
            for _ in range(100):
                peer.sendall(line)
        except OSError:
            continue


def small_headers(address: tuple[str, int], stack: ExitStack) -> None:
    for _ in range(60):
        peer = stack.enter_context(socket.create_connection(address))
        try:
            peer.sendall(HEAD + b"a:\r\n" * 1_000_000)
        except OSError:
            continue


def slow_readers(address: tuple[str, int], stack: ExitStack) -> None:
    for _ in range(250):
        peer = stack.enter_context(socket.create_connection(address))
        peer.sendall(HEAD.replace(b"manifest.json", b"groups/0000.safetensors") + b"\r\n")


@pytest.mark.skipif(not os.path.exists("/proc/self/status"), reason="memory is read from /proc")
@pytest.mark.parametrize("attack", [big_headers, small_headers, slow_readers])
def test_attacks_take_little_memory(tmp_path: Path, attack: Callable[[tuple[str, int], ExitStack], None]):
    command = [sys.executable, "-m", "splatreel", "serve", str(large_reel(tmp_path)), "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process, ExitStack() as stack:
        stack.callback(process.terminate)
        assert process.stdout is not None
        url = urlsplit(process.stdout.readline().split()[2])
        assert url.hostname
        assert url.port
        ask(url.netloc)
        before = peak(process.pid)
        attack((url.hostname, url.port), stack)
        assert min(ask(url.netloc) for _ in range(3)) < 1
        assert peak(process.pid) - before < 100e6


def peak(pid: int) -> int:
    """Most bytes that a process ever took."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("VmHWM"))
