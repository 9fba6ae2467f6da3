"""QR codes at the terminal."""

from __future__ import annotations

import io
import sys

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
