"""Limits of the web server: slow, excessive and stalled requests use little memory and delay no other request."""

import http.client
import os
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from splatreel.play import connection
from splatreel.play.server import Server, serve
from tests.golden import GOLDEN
from tests.play.attacks import ATTACKS, GET, GET_LARGE, HEAD, LARGE, large_reel, served
from tests.play.test_server import request


@pytest.fixture
def server() -> Iterator[Server]:
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
    monkeypatch.setattr(connection, name, 0.3)


def test_slow_headers_time_out(server: Server, monkeypatch: pytest.MonkeyPatch):
    shorten(monkeypatch, "REQUEST_SECONDS")
    with dial(server) as peer:
        try:
            for byte in HEAD * 100:
                peer.sendall(bytes([byte]))
                time.sleep(0.02)
        except ConnectionError:
            return
    pytest.fail("it was not given up")


def test_slow_second_request_times_out(server: Server, monkeypatch: pytest.MonkeyPatch):
    shorten(monkeypatch, "REQUEST_SECONDS")
    monkeypatch.setattr(connection, "IDLE_SECONDS", 1000)
    with dial(server) as peer:
        peer.sendall(GET + HEAD)
        assert received(peer).count(b"HTTP/1.1 200") == 1  # it ends: else this times out


def test_idle_connection_times_out(server: Server, monkeypatch: pytest.MonkeyPatch):
    shorten(monkeypatch, "IDLE_SECONDS")
    with dial(server) as peer:
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
    monkeypatch.setattr(connection, "STALL_SECONDS", 2.0)
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
def test_connection_answers_two_pipelined_requests_and_closes(server: Server, count: int):
    """Then the connection ends; those who send them so must be ready to send the others again."""
    with dial(server) as peer:
        with suppress(ConnectionError):
            peer.sendall(GET * count)
        answers = received(peer).count(b"HTTP/1.1 200")
    assert answers == 2 or (count > 3 and answers < 2), "what is unread when a connection ends takes answers with it"


def test_connection_answers_sequential_requests(server: Server):
    address = urlsplit(server.url)
    asking = http.client.HTTPConnection(address.netloc, timeout=120)
    asking.connect()
    first = asking.sock
    for _ in range(50):
        asking.request("GET", "/reel/manifest.json")
        assert asking.getresponse().read() == (GOLDEN / "manifest.json").read_bytes()
    assert asking.sock is first
    asking.close()


def test_new_connection_replaces_longest_waiting_one(server: Server):
    """The connection that waited longest is given up, not the newest."""
    with ExitStack() as stack:
        for _ in range(300):
            stack.enter_context(dial(server)).sendall(HEAD)
        assert request(server, "/reel/manifest.json")[0].status == 200


def test_connection_limit_keeps_active_readers(server: Server):
    with dial(server) as peer, ExitStack() as stack:
        peer.sendall(GET)
        assert peer.recv(1 << 16).startswith(b"HTTP/1.1 200")
        for _ in range(200):
            stack.enter_context(dial(server)).sendall(HEAD)
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
        monkeypatch.setattr(connection, name, 1000)
    server = serve(large_reel(tmp_path), port=0)
    with ExitStack() as stack:
        for sent in (b"", HEAD, GET, GET_LARGE):
            stack.enter_context(dial(server)).sendall(sent)
        time.sleep(0.2)
        closing = threading.Thread(target=server.close)
        closing.start()
        closing.join(120)
        assert not closing.is_alive()
