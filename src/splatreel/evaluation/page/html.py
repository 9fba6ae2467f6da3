"""Parts of the HTML of report pages."""

from __future__ import annotations

import base64
import html
import io
import math
import re
from collections.abc import Iterable, Mapping, Sequence
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


WIDTH, HEIGHT = 480, 240
LEFT, RIGHT, TOP, BOTTOM = 64, 12, 14, 46
_MARKED = 40
"""Largest number of points of a line that are marked one by one."""

Series = Mapping[str, Sequence[tuple[float, float]]]


def line_chart(
    series: Series,
    x_label: str,
    y_label: str,
    borders: Sequence[float] = (),
    x_range: tuple[float, float] | None = None,
) -> str:
    """Return a chart as an SVG element.

    Args:
        series: (x, y) pairs of each line, by its name. Empty lines are left out. The horizontal axis has whole numbers.
        x_label: Label of the horizontal axis.
        y_label: Label of the vertical axis.
        borders: Places of vertical lines, such as the first frames of groups.
        x_range: Ends of the horizontal axis, of which the second one has no number; by default those of the lines.

    Raises:
        ValueError: There are no points.
    """
    lines = {name: sorted(points) for name, points in series.items() if points}
    if not lines:
        raise ValueError("there is nothing to draw")
    xs = [x for points in lines.values() for x, _ in points]
    ys = [y for points in lines.values() for _, y in points]
    left, right = x_range or (min(xs), max(xs))
    x_ticks = [x for x in ticks(left, right) if x == round(x) and (x_range is None or x < right)]
    y_ticks = ticks(min(ys), max(ys))
    low, high = (left, max(right, left + 1e-9)), (y_ticks[0], y_ticks[-1])

    def x_of(value: float) -> float:
        return round(LEFT + (value - low[0]) / (low[1] - low[0]) * (WIDTH - LEFT - RIGHT), 1)

    def y_of(value: float) -> float:
        return round(HEIGHT - BOTTOM - (value - high[0]) / (high[1] - high[0]) * (HEIGHT - TOP - BOTTOM), 1)

    parts = [f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape(described(lines, y_label))}">']
    for value in y_ticks:
        parts.append(f'<path class="grid" d="M{LEFT} {y_of(value)}H{WIDTH - RIGHT}"/>')
        parts.append(f'<text x="{LEFT - 6}" y="{y_of(value) + 4}" text-anchor="end">{number(value)}</text>')
    for value in x_ticks:
        if low[0] <= value <= low[1]:
            place = f'x="{x_of(value)}" y="{HEIGHT - BOTTOM + 18}"'
            parts.append(f'<text {place} text-anchor="middle">{number(value)}</text>')
    for value in borders:
        if low[0] < value < low[1]:
            parts.append(f'<path class="border" d="M{x_of(value)} {TOP}V{HEIGHT - BOTTOM}"/>')
    for index, points in enumerate(lines.values()):
        places = [(x_of(x), y_of(y)) for x, y in points]
        parts.append(f'<polyline class="line s{index % 4}" points="{" ".join(f"{x},{y}" for x, y in places)}"/>')
        if len(places) <= _MARKED:
            parts += [f'<circle class="s{index % 4}" cx="{x}" cy="{y}" r="3"/>' for x, y in places]
    parts.append(f'<text x="{WIDTH - RIGHT}" y="{HEIGHT - 8}" text-anchor="end">{escape(x_label)}</text></svg>')
    keys = "".join(f'<li class="s{index % 4}">{escape(name)}</li>' for index, name in enumerate(lines))
    return "".join([*parts, f'<ul class="keys">{keys}</ul>' if len(lines) > 1 else ""])


def described(lines: Series, label: str) -> str:
    """Return the text that stands for a chart: range and last value of each line."""
    found = [
        f"{name}: {number(min(y for _, y in points))} to {number(max(y for _, y in points))}, "
        f"at the end {number(points[-1][1])}"
        for name, points in lines.items()
    ]
    return f"{label}. {'; '.join(found)}"


def ticks(low: float, high: float, count: int = 4) -> list[float]:
    """Return about `count` round numbers that enclose a range."""
    largest = max(abs(low), abs(high))
    if high - low <= 1e-9 * max(largest, 1e-9):
        room = 0.5 * largest if largest > 1e-9 else 0.5
        low, high = low - room, high + room
    rough = (high - low) / count
    power = 10.0 ** math.floor(math.log10(rough))
    step = power * next(factor for factor in (1, 2, 5, 10) if factor * power >= rough * (1 - 1e-9))
    first, last = math.floor(low / step + 1e-12), math.ceil(high / step - 1e-12)
    return [step * place for place in range(first, last + 1)]


def number(value: float) -> str:
    """Format a number with at most four digits, for example 0.0213 or 12,300."""
    if abs(value) >= 1000:
        return f"{value:,.0f}"
    return f"{value:.3g}" if value else "0"
