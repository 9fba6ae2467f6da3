"""Command lines that messages tell the user to run. They can be pasted into the shell of the system."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from splatreel.base.errors import MissingDependencyError

_PLAIN = re.compile(r"[\w@+=:,./-]+", re.ASCII)
_PLAIN_ON_WINDOWS = re.compile(r"[\w@+=:,./\\-]+")

EXTRAS = {"torch": "recon", "cv2": "recon", "pycolmap": "recon", "gsplat": "cuda", "viser": "viewer"}
"""Extra of the package that installs an optional module."""


def quoted(arguments: Sequence[object], windows: bool = os.name == "nt") -> str:
    """Return a command line, with double quotes where a name needs quotes.

    Shells of Linux, macOS and Windows all know double quotes; cmd.exe takes single quotes as a part of a name.

    Args:
        arguments: The command and its arguments.
        windows: True for cmd.exe and PowerShell, False for POSIX shells.
    """
    return " ".join(_quoted_for_windows(str(a)) if windows else _quoted_for_posix(str(a)) for a in arguments)


def install_command(extra: str, *packages: str) -> str:
    """Return the pip command that installs an extra of this package and further packages.

    Args:
        extra: Name of the extra, such as recon.
        *packages: Other packages to install with it.
    """
    return " ".join(["pip install", f'"splatreel[{extra}]"', *packages])


def missing_package(module: str | None) -> str | None:
    """Return the message about an optional module that is not installed; None for a module that no extra installs."""
    if module not in EXTRAS:
        return None
    return f"the Python package {module!r} is needed and not installed. Run\n  {install_command(EXTRAS[module])}"


@contextmanager
def needing_packages() -> Iterator[None]:
    """Raise `MissingDependencyError`, with the pip command, where an optional package is not installed."""
    try:
        yield
    except ModuleNotFoundError as error:
        if (message := missing_package(error.name)) is None:
            raise
        raise MissingDependencyError(message) from error


def _quoted_for_posix(argument: str) -> str:
    if _PLAIN.fullmatch(argument):
        return argument
    # Within double quotes these characters keep a meaning.
    return shlex.quote(argument) if set(argument) & set('"$`\\!\n') else f'"{argument}"'


def _quoted_for_windows(argument: str) -> str:
    if _PLAIN_ON_WINDOWS.fullmatch(argument):
        return argument
    escaped = subprocess.list2cmdline([argument])
    # `list2cmdline` adds quotes for blanks only, and cmd.exe interprets & | < > ^ ( ) outside of quotes.
    return escaped if escaped.startswith('"') else f'"{escaped}"'
