"""Names by which a server may be asked for."""

import http.client
import socket
from urllib.parse import urlsplit

import pytest

from splatreel.base.errors import UsageError
from splatreel.play.server import serve
from splatreel.play.web_app import AllowedHosts
from tests.golden import GOLDEN

ITSELF = ["localhost", "LOCALHOST:80", "localhost.", "127.0.0.1:8080", "[::1]:8080", "127.8.8.8"]
NO_NAMES = ["", "a b", "evil.example:80:80", "localhost@evil.example", "[::1", 'a"><script>', "localhost/x"]
OTHERS = ["evil.example", "localhost.evil.example", "127.0.0.1.evil.example:8080", "2130706433"]


@pytest.mark.parametrize("bound", ["127.0.0.1", "::1"])
def test_loopback_server_answers_to_loopback_names_only(bound: str):
    names = AllowedHosts(bound, bound)
    for host in ITSELF:
        assert host in names, host
    for host in (*NO_NAMES, *OTHERS, "192.168.0.7:8080", "[fe80::1]", socket.gethostname() + ".example"):
        assert host not in names, host


@pytest.mark.parametrize("bound", ["0.0.0.0", "::", "192.168.0.7", "fe80::1%eth0"])
def test_network_server_answers_to_addresses_and_machine_names(bound: str):
    names = AllowedHosts(bound, "Reels.example")
    machine = socket.gethostname()
    for host in (*ITSELF, "192.168.0.7:8080", "[fe80::1]:1", "reels.example", machine, f"{machine}.local:8080"):
        assert host in names, host
    for host in (*NO_NAMES, *OTHERS):
        assert host not in names, host


def test_allowed_hosts_accept_further_names():
    names = AllowedHosts("127.0.0.1", "127.0.0.1", ["Tunnel.example."])
    assert "tunnel.example:443" in names
    assert "other.example" not in names
    for wrong in ("https://tunnel.example", "tunnel.example:80", "", "*"):
        with pytest.raises(UsageError, match="is not the name of a host"):
            AllowedHosts("127.0.0.1", "127.0.0.1", [wrong])


def test_unknown_host_is_refused_with_remedy():
    with serve(GOLDEN, port=0) as server:
        status, text = ask(server.url, "rebound.example:80")
        assert status == 421
        assert "--allow-host rebound.example" in text
        assert ask(server.url, "x\x7f<script>") == (421, "The request has no valid Host header.\n")
        assert ask(server.url, "localhost:1")[0] == 200
    with serve(GOLDEN, port=0, allow_hosts=["rebound.example"]) as server:
        assert ask(server.url, "rebound.example:80")[0] == 200


def ask(url: str, host: str) -> tuple[int, str]:
    connection = http.client.HTTPConnection(urlsplit(url).netloc, timeout=60)
    try:
        connection.request("GET", "/reel/manifest.json", headers={"Host": host})
        answer = connection.getresponse()
        return answer.status, answer.read().decode()
    finally:
        connection.close()


def test_invalid_host_name_frees_port():
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with pytest.raises(UsageError, match="not the name"):
        serve(GOLDEN, port=port, allow_hosts=["a/b"])
    serve(GOLDEN, port=port).close()
