"""Printing of messages. Texts of reels, captures and file names are untrusted: no control sequence in them reaches a terminal."""

from __future__ import annotations

import sys
from pathlib import Path

from splatreel.base.command_line import quoted
from splatreel.base.progress import printable

_PLAIN = str.maketrans("█░", "#.")
"""Replacements of the bars of charts where a terminal has no block characters."""


def say(text: str = "", end: str = "\n", flush: bool = False) -> None:
    """Print to standard output in any encoding. Characters that the encoding lacks are escaped."""
    text, encoding = printable(text), sys.stdout.encoding or "utf-8"
    try:
        text.encode(encoding)
    except UnicodeEncodeError:
        text = text.translate(_PLAIN).encode(encoding, "backslashreplace").decode(encoding)
    print(text, end=end, flush=flush)


def counted(number: int, noun: str) -> str:
    """Return a number and a noun, such as `1 group` or `2 groups`."""
    return f"{number:,} {noun}{'' if number == 1 else 's'}"


def serving(reel: Path) -> str:
    """Return the command that plays a reel."""
    return quoted(["splatreel", "serve", reel])


def playable(reel: Path) -> str:
    """Return the closing message about a new reel."""
    return f"{reel}: play it with\n  {serving(reel)}"


def already_complete(out: Path) -> str:
    """Return the message about an output that an earlier run of the same command finished."""
    return f"{out}: was complete already, with the same content"
