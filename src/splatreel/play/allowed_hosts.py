"""Host names that a server answers to.

They protect against DNS rebinding, by which another site points its own name to this machine to read a reel.
"""

from __future__ import annotations

import ipaddress
import re
import socket
from collections.abc import Iterable

from splatreel.base.errors import UsageError

_HOST = re.compile(r"(?:([A-Za-z0-9._-]{1,253})|\[([0-9A-Fa-f:.]{2,45})\])(?::\d{1,5})?")


class AllowedHosts:
    """Permitted values of a Host header.

    A server on a loopback address answers to localhost and loopback addresses. Other servers also answer to any IP address, to this
    machine's name and to the host name they were started with.
    """

    def __init__(self, bound: str, given: str, allowed: Iterable[str] = ()) -> None:
        """Collect the permitted names.

        Args:
            bound: IP address that the server listens on.
            given: The same host as the user wrote it.
            allowed: Further names, such as that of a proxy.

        Raises:
            UsageError: One of `allowed` is not a host name.
        """
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
    """Return the name or address in a Host header, without port and brackets; None for an invalid header."""
    match = _HOST.fullmatch(header)
    return (match[1] or match[2]).lower().removesuffix(".") if match else None


def _checked(name: str) -> str:
    if not re.fullmatch(r"[A-Za-z0-9._-]{1,253}|[0-9A-Fa-f:.]{2,45}", name):
        raise UsageError(
            f"{name!r:.100} is not the name of a host. Give it without scheme, port and path: reels.example"
        )
    return name.lower().removesuffix(".")
