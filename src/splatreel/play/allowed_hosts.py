"""Host names that a server answers to, so that a page elsewhere cannot read a reel by giving its own name this machine's address
(DNS rebinding)."""

from __future__ import annotations

import ipaddress
import re
import socket
from collections.abc import Iterable

from splatreel.errors import UsageError

_HOST = re.compile(r"(?:([A-Za-z0-9._-]{1,253})|\[([0-9A-Fa-f:.]{2,45})\])(?::\d{1,5})?")


class AllowedHosts:
    """What a Host header may say.

    bound: the address that the server listens on; given: as the user called it. Where it is one of this machine's own (loopback), only
    localhost and addresses of that kind; else any address, which no other site can have for a name, localhost, this machine's name
    and `given`. allowed: further names. Raises `UsageError` for one that is none.
    """

    def __init__(self, bound: str, given: str, allowed: Iterable[str] = ()) -> None:
        self._loopback = ipaddress.ip_address(bound.split("%")[0]).is_loopback
        self._names = {"localhost", *map(_checked, allowed)}
        if not self._loopback:
            machine = socket.gethostname().lower()
            self._names |= {given.lower(), machine, f"{machine}.local"}

    def __contains__(self, header: object) -> bool:
        name = host_name(header) if isinstance(header, str) else None
        if name is None:
            return False
        try:
            return ipaddress.ip_address(name).is_loopback or not self._loopback or name in self._names
        except ValueError:
            return name in self._names


def host_name(header: str) -> str | None:
    """The name or address in a Host header, without its port and brackets; None if it is no such header."""
    match = _HOST.fullmatch(header)
    return (match[1] or match[2]).lower().removesuffix(".") if match else None


def _checked(name: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9._-]{1,253}|[0-9A-Fa-f:.]{2,45}", name):
        raise UsageError(
            f"{name!r:.100} is not the name of a host. Give it without scheme, port and path: reels.example"
        )
    return name.lower().removesuffix(".")
