"""Attacks on a web server, each of bounded size and time, and a server process to be attacked. Loopback only."""

from __future__ import annotations

import http.client
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from socket import create_connection, socket
from typing import NamedTuple
from urllib.parse import urlsplit

from tests.golden import GOLDEN

HEAD = b"GET /reel/manifest.json HTTP/1.1\r\nHost: localhost\r\n"
GET = HEAD + b"\r\n"
GET_LARGE = GET.replace(b"manifest.json", b"groups/0000.safetensors")
LARGE = 24 << 20
"""Bytes of the file that `GET_LARGE` names, in a `large_reel`."""


class Served(NamedTuple):
    """A server in a process of its own."""

    address: tuple[str, int]
    pid: int

    def ask(self) -> float:
        """Seconds for one request on a connection of its own."""
        begun = time.monotonic()
        asking = http.client.HTTPConnection(*self.address, timeout=120)
        asking.request("GET", "/reel/manifest.json")
        answer = asking.getresponse()
        assert (answer.status, answer.read()) == (200, (GOLDEN / "manifest.json").read_bytes())
        asking.close()
        return time.monotonic() - begun

    def peak(self) -> int:
        """Most bytes of memory that the process ever took (Linux)."""
        lines = Path(f"/proc/{self.pid}/status").read_text().splitlines()
        return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("VmHWM"))


@contextmanager
def served(reel: Path) -> Iterator[Served]:
    """`splatreel serve`, after its first answer."""
    command = [sys.executable, "-m", "splatreel", "serve", str(reel), "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            url = urlsplit(process.stdout.readline().split()[2])
            assert url.hostname is not None
            assert url.port is not None
            running = Served((url.hostname, url.port), process.pid)
            running.ask()
            yield running
        finally:
            process.terminate()


def large_reel(folder: Path) -> Path:
    """One whose first group's file is large, and nothing but zeros: nobody but a server reads it."""
    reel = folder / "reel"
    (reel / "groups").mkdir(parents=True)
    (reel / "manifest.json").write_bytes((GOLDEN / "manifest.json").read_bytes())
    with (reel / "groups" / "0000.safetensors").open("wb") as file:
        file.truncate(LARGE)
    return reel


def send(address: tuple[str, int], count: int, *parts: bytes) -> list[socket]:
    """`count` connections, open, of which each sent what the server took of these parts, waiting at most 0.3 s for it to take more."""
    peers = []
    for _ in range(count):
        with suppress(OSError):
            peer = create_connection(address, timeout=0.3)
            peers.append(peer)
            for part in parts:
                peer.sendall(part)
    return peers


def large_headers(address: tuple[str, int]) -> list[socket]:
    """98 headers of 61 KB on each of 60 connections."""
    return send(address, 60, HEAD, *[b"x: " + b"y" * 61_000 + b"\r\n"] * 98)


def many_headers(address: tuple[str, int]) -> list[socket]:
    """4 MB of the smallest headers on each of 60 connections."""
    return send(address, 60, HEAD, *[b"a:\r\n" * 10_000] * 100)


def begun_requests(address: tuple[str, int]) -> list[socket]:
    """400 connections with requests that do not end."""
    return send(address, 400, HEAD)


def silent_connections(address: tuple[str, int]) -> list[socket]:
    return send(address, 400)


def stalled_readers(address: tuple[str, int]) -> list[socket]:
    """250 that ask for 24 MB and read nothing."""
    return send(address, 250, GET_LARGE)


def unread_requests(address: tuple[str, int]) -> list[socket]:
    """100 connections with 20,000 requests in one go, whose answers are not read."""
    return send(address, 100, *[GET * 1000] * 20)


def large_bodies(address: tuple[str, int]) -> list[socket]:
    """6 MB of a body on each of 60 connections."""
    head = HEAD.replace(b"GET", b"POST") + b"Content-Length: 6000000\r\n\r\n"
    return send(address, 60, head, *[bytes(60_000)] * 100)


ATTACKS: tuple[Callable[[tuple[str, int]], list[socket]], ...] = (
    large_headers,
    many_headers,
    begun_requests,
    silent_connections,
    stalled_readers,
    unread_requests,
    large_bodies,
)


def trickle(peers: list[socket], seconds: float) -> None:
    """Hold what an attack opened: every 50 ms each sends a byte of a header and reads one, as long as the server lets it."""
    with ExitStack() as stack:
        for peer in peers:
            stack.enter_context(peer).setblocking(False)
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            for peer in peers:
                with suppress(OSError):
                    peer.send(b"z")
                    peer.recv(1)
            time.sleep(0.05)
