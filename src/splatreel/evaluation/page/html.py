"""Parts of the HTML of report pages."""

from __future__ import annotations

import base64
import html
import io
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from PIL import Image

from splatreel.base.progress import printable

STYLE = Path(__file__).with_name("report.css")
LONGEST = 4000
"""Characters of an untrusted text that are shown: a name of a camera, file or folder, or a note that quotes one."""


def escape(text: str) -> str:
    """Return text for HTML, shortened, with control characters and marks that reverse letters written as escapes."""
    shown = text if len(text) <= LONGEST else f"{text[:LONGEST]}…"
    return html.escape(printable(shown))


def html_page(title: str, heading: str, subtitle: str, sections: Iterable[str]) -> str:
    """Return a page that needs no other file. Empty sections are left out."""
    return "\n".join(
        [
            '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{escape(title)}</title>",
            f"<style>\n{STYLE.read_text(encoding='utf-8')}</style>\n</head>\n<body>\n<main>",
            f'<header id="title"><h1>{escape(heading)}</h1>\n<p class="soft">{escape(subtitle)}</p></header>',
            *filter(None, sections),
            "</main>\n</body>\n</html>\n",
        ]
    )


def section(title: str, content: str, kind: str = "") -> str:
    """Return a section with its heading; nothing without content."""
    if not content:
        return ""
    name = title.lower().replace(" ", "-")
    return f'<section class="sections {kind}" id="{name}">\n<h2>{title}</h2>\n{content}\n</section>'


def html_list(items: Iterable[str]) -> str:
    """Return a list of sentences; nothing without items."""
    lines = "".join(f"<li>{with_code(item)}</li>" for item in items)
    return f"<ul>{lines}</ul>" if lines else ""


def html_table(heads: Sequence[str], rows: Iterable[Sequence[str]], kind: str = "") -> str:
    """Return a table whose first column holds the names of its rows."""
    head = "".join(f'<th scope="col">{escape(name)}</th>' for name in heads)
    body = "".join(
        f'<tr><th scope="row">{escape(row[0])}</th>{"".join(f"<td>{escape(cell)}</td>" for cell in row[1:])}</tr>'
        for row in rows
    )
    table = f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
    return f'<div class="wide {kind}" tabindex="0" role="region" aria-label="{escape(heads[0])}">{table}</div>'


def jpeg_url(image: Image.Image, longest: int) -> str:
    """Return an image as the data URL of a JPEG, reduced to a longer side of `longest` pixels."""
    image.thumbnail((longest, longest))
    file = io.BytesIO()
    image.save(file, "JPEG", quality=85)
    return f"data:image/jpeg;base64,{base64.b64encode(file.getvalue()).decode()}"


def with_code(text: str) -> str:
    """Return escaped text, with what stands between backticks as code."""
    return re.sub("`([^`]+)`", r"<code>\1</code>", escape(text))
