"""Parts of the HTML of report pages."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from PIL import Image

from splatreel.evaluation.page.escaping import escape
from splatreel.evaluation.page.rig_plan import RigPlan

STYLE = Path(__file__).with_name("report.css")


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


def rig_drawings(plan: RigPlan) -> str:
    """Return the plan and the elevation of the cameras, with a legend."""
    titles = ("Plan, from above", "Elevation, from behind")
    parts = [f"<section><h3>{title}</h3>{svg}</section>" for title, svg in zip(titles, plan.drawings(), strict=True)]
    lines = '<li class="s2">most points in common (two lines a camera; the darker, the more)</li>' if plan.links else ""
    legend = f'<ul class="keys"><li class="s0">trained (circle)</li><li class="s1">held out (square)</li>{lines}</ul>'
    return f'{legend}<div class="charts rig">{"".join(parts)}</div>'


def jpeg_url(image: Image.Image, longest: int) -> str:
    """Return an image as the data URL of a JPEG, reduced to a longer side of `longest` pixels."""
    image.thumbnail((longest, longest))
    file = io.BytesIO()
    image.save(file, "JPEG", quality=85)
    return f"data:image/jpeg;base64,{base64.b64encode(file.getvalue()).decode()}"


def with_code(text: str) -> str:
    """Return escaped text, with what stands between backticks as code."""
    return re.sub("`([^`]+)`", r"<code>\1</code>", escape(text))
