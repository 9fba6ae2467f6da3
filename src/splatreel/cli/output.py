"""What verbs print. Texts of reels, captures and file names are anybody's: nothing in them reaches a terminal as a command."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

from splatreel.progress import printable

_PLAIN = str.maketrans("█░", "#.")
"""The bars of charts, where a terminal has no blocks."""


def say(text: str = "", end: str = "\n", flush: bool = False) -> None:
    """Print to standard output, whatever its encoding: what it does not have is escaped."""
    text, encoding = printable(text), sys.stdout.encoding or "utf-8"
    try:
        text.encode(encoding)
    except UnicodeEncodeError:
        text = text.translate(_PLAIN).encode(encoding, "backslashreplace").decode(encoding)
    print(text, end=end, flush=flush)


def counted(number: int, noun: str) -> str:
    """Such as `1 group` and `2 groups`."""
    return f"{number:,} {noun}{'' if number == 1 else 's'}"


def serving(reel: Path) -> str:
    """The command that plays a reel, to be copied."""
    return f"splatreel serve {shlex.quote(str(reel))}"


def playable(reel: Path) -> str:
    """What is said of a reel that was just made."""
    return f"{reel}: play it with\n  {serving(reel)}"
