"""Untrusted texts in pages and tables: names of cameras, files and folders, and notes that quote them."""

from __future__ import annotations

import html

from splatreel.base.progress import printable

LONGEST = 4000
"""Characters of a text that are shown."""


def escape(text: str) -> str:
    """Return text for HTML, shortened, with control characters and marks that reverse letters written as escapes."""
    shown = text if len(text) <= LONGEST else f"{text[:LONGEST]}…"
    return html.escape(printable(shown))
