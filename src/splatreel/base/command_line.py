"""Command lines that messages tell the user to run. They can be pasted into the shell of the system."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import PurePath

from splatreel.base.errors import MissingDependencyError
from splatreel.base.progress import printable

_PLAIN = re.compile(r"[\w@+=:,./-]+", re.ASCII)
_PLAIN_ON_WINDOWS = re.compile(r"[\w@+=:,./\\-]+")

EXTRAS = {"cv2": "recon", "pycolmap": "recon", "gsplat": "cuda", "viser": "viewer"}
"""Extra of the package that installs an optional module."""


def quoted(arguments: Sequence[object], windows: bool = os.name == "nt") -> str:
    """Return a command line, with double quotes where a name needs quotes.

    Shells of Linux, macOS and Windows all know double quotes; cmd.exe takes single quotes as a part of a name. Characters that
    cannot be printed, and bytes of a name that are not UTF-8, become escapes that bash and zsh read, in $'...'.

    Args:
        arguments: The command and its arguments. Give names of files as paths: a path that starts with a dash gets ./ before it.
        windows: True for cmd.exe and PowerShell, False for POSIX shells.
    """
    write = _quoted_for_windows if windows else _quoted_for_posix
    return " ".join(write(_named(argument)) for argument in arguments)


def option(name: str, value: object) -> list[str]:
    """Return the arguments of an option. A value that starts with a dash would be taken for another option after a blank."""
    return [f"{name}={value}"] if str(value).startswith("-") else [name, str(value)]


def install_command(extra: str, *packages: str) -> str:
    """Return the pip command that installs an extra of this package and further packages.

    Args:
        extra: Name of the extra, such as recon.
        *packages: Other packages to install with it.
    """
    return " ".join(["pip install", f'"splatreel[{extra}]"', *packages])


def missing_package(module: str | None) -> str | None:
    """Return the message about an optional module that is not installed; None for a module that is not optional."""
    if module != "torch" and module not in EXTRAS:
        return None
    command = install_command(EXTRAS[module]) if module in EXTRAS else f"pip install {module}"
    return f"the Python package {module!r} is needed and not installed. Run\n  {command}"


def _named(argument: object) -> str:
    """Return an argument as text. A path that starts with a dash would be taken for an option."""
    text = str(argument)
    return f"./{text}" if isinstance(argument, PurePath) and text.startswith("-") else text


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
    if _PLAIN.fullmatch(argument) and not argument.startswith("="):  # zsh replaces =NAME by the path of a program
        return argument
    if printable(argument) != argument or set(argument) & set("\n\t"):
        return f"$'{''.join(map(_escaped_for_posix, argument))}'"
    # Within double quotes these characters keep a meaning.
    return shlex.quote(argument) if set(argument) & set('"$`\\!\n') else f'"{argument}"'


def _escaped_for_posix(character: str) -> str:
    r"""Return a character between $' and ', which has the escapes of C. ! would be replaced by an earlier command."""
    if character.isprintable() and character not in "'\\!":
        return character
    try:
        data = character.encode("utf-8", "surrogateescape")  # a byte of a name that is not UTF-8
    except UnicodeEncodeError:
        data = character.encode("utf-8", "surrogatepass")
    return "".join(f"\\x{byte:02x}" for byte in data)


def _quoted_for_windows(argument: str) -> str:
    if _PLAIN_ON_WINDOWS.fullmatch(argument):
        return argument
    escaped = subprocess.list2cmdline([argument])
    # `list2cmdline` adds quotes for blanks only, and cmd.exe interprets & | < > ^ ( ) outside of quotes.
    return escaped if escaped.startswith('"') else f'"{escaped}"'
