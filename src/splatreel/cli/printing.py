"""Printing of messages and QR codes.

Texts of reels, captures and file names are untrusted: no control sequence in them reaches a terminal.
"""

from __future__ import annotations

import io
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


_BLOCKS = "▀▄█"


def print_qr_code(text: str) -> None:
    """Print a text as a QR code, if standard output is a terminal that has block characters."""
    if not sys.stdout.isatty() or not _has_blocks(sys.stdout.encoding):
        return
    from rich.console import Console

    # Readers need dark on light, whatever the colors of the terminal are.
    Console().print(qr_code(text), style="bright_white on black", highlight=False, markup=False, no_wrap=True)


def qr_code(text: str) -> str:
    """Return the QR code of a text in lines of block characters, each two modules high. Blocks are the light modules."""
    import segno

    lines = io.StringIO()
    segno.make(text, error="l", micro=False).terminal(lines, border=2, compact=True)
    return lines.getvalue().rstrip("\n")


def _has_blocks(encoding: str) -> bool:
    try:
        _BLOCKS.encode(encoding)
    except UnicodeEncodeError:
        return False
    return True
