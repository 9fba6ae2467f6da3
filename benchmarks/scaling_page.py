"""Write the tables and the plot of docs/scaling.md from the records of benchmarks/scaling.py."""

import json
import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from document import replaced_between
from loglog import Panel, charts
from record import RESULTS, ROOT

Row = dict[str, Any]
PAGE = ROOT / "docs" / "scaling.md"
PLOT = ROOT / "docs" / "images" / "scaling.svg"
BEGIN, END = "<!-- results: written by benchmarks/scaling.py --show -->", "<!-- end of results -->"
replaced = partial(replaced_between, BEGIN, END)
"""Function from a document and a text to the document with the text between its markers."""
MISSING = "*not measured yet: `python benchmarks/scaling.py`, then with `--show`*"

AXES = {
    "pixels": "megapixels",
    "cameras": "cameras",
    "threads": "threads",
    "workers": "workers, of one thread",
    "frames": "frames",
}
"""What is varied, and what a value of it counts."""
TIME, MEMORY = "seconds_wall", "memory_mb"
COLUMNS = (
    "case",
    "pictures",
    "cameras",
    "frames",
    "threads",
    "seconds",
    "memory MB",
    "points",
    "load before",
    "commit",
)
SHARE = 0.05
"""Of a run's time, what a stage takes at least for its exponent to be told."""
ALLOWED = 0.05
"""By how much memory may grow from the second group to the last one: the project's own bound."""
EARLY, LATE = 1, 99
"""The groups that are compared, counted from 0."""


def number_of(axis: str, row: Row) -> float:
    """Return the value of a record on an axis."""
    return row["width"] * row["height"] / 1e6 if axis == "pixels" else row[axis]


def value_of(axis: str, row: Row) -> str:
    """Return the value in words; megapixels have two digits."""
    number = number_of(axis, row)
    return f"{number:.2g}" if axis == "pixels" else str(number)


def rows(results: Path = RESULTS) -> list[Row]:
    """Return all records of scaling, the latest last."""
    lines = results.read_text(encoding="utf-8").splitlines() if results.exists() else []
    return [row for line in lines if line.strip() and (row := json.loads(line))["benchmark"].startswith("scaling ")]


def records(results: Path = RESULTS) -> dict[str, list[Row]]:
    """Return the latest record of each value on an axis, from the smallest."""
    latest = {row["benchmark"]: row for row in rows(results)}
    by_axis = {axis: [row for row in latest.values() if row["axis"] == axis] for axis in AXES}
    return {axis: sorted(some, key=lambda row: number_of(axis, row)) for axis, some in by_axis.items()}


def exponent(points: Sequence[tuple[float, float]]) -> float | None:
    """Return the slope of log y against log x by least squares; None if it is undefined."""
    if len(points) < 2 or min(min(point) for point in points) <= 0:
        return None
    logs = [(math.log(x), math.log(y)) for x, y in points]
    middle_x, middle_y = (sum(values) / len(logs) for values in zip(*logs, strict=True))
    spread = sum((x - middle_x) ** 2 for x, _ in logs)
    return sum((x - middle_x) * (y - middle_y) for x, y in logs) / spread if spread else None


def points_of(axis: str, some: Sequence[Row], name: str) -> list[tuple[float, float]]:
    """Return (value, number `name`) of the rows with no more threads than cores."""
    return [(number_of(axis, row), row[name]) for row in some if row["threads"] <= row["cores"]]


def page(by_axis: dict[str, list[Row]]) -> str:
    """Return the Markdown between the markers."""
    if not any(by_axis.values()):
        return MISSING
    notes = [f"- {text}" for axis, some in by_axis.items() for text in (stages(axis, some), memory(axis, some)) if text]
    machines = sorted({str(row["machine_before"]).partition(", load ")[0] for some in by_axis.values() for row in some})
    plot_link = f"![Time and memory against each axis, both logarithmic](images/{PLOT.name})"
    measured = f"Measured on {'; '.join(machines)}."
    return "\n\n".join([plot_link, summary(by_axis), table(by_axis), "\n".join(notes), measured])


def summary(by_axis: dict[str, list[Row]]) -> str:
    """Return a table of the exponents of each axis."""
    lines = [_line(("axis", "values", "time", "time, last two", "memory", "memory, last two")), _line(["---"] * 6)]
    for axis, some in by_axis.items():
        values = ", ".join(value_of(axis, row) for row in some)
        found = [points_of(axis, some, name) for name in (TIME, MEMORY)]
        cells = [_exponent(exponent(points[-last:])) for points in found for last in (len(points) or 1, 2)]
        lines.append(_line((AXES[axis], values or "not measured", *cells)))
    return "\n".join(lines)


def table(by_axis: dict[str, list[Row]]) -> str:
    """Return a table with a row for each case."""
    lines = [_line(COLUMNS), _line(["---"] * len(COLUMNS))]
    for axis, some in by_axis.items():
        for row in some:
            cells = (
                f"{AXES[axis].partition(',')[0]} {value_of(axis, row)}",
                f"{row['width']}x{row['height']}",
                str(row["cameras"]),
                str(row["frames"]),
                str(row["threads"]) + crowded(row),
                f"{row[TIME]:,.1f}",
                f"{row[MEMORY]:,.0f}",
                f"{row['points']:,}",
                str(row["machine_before"]).partition(", load ")[2] or "not known",
                f"`{row['revision']}`",
            )
            lines.append(_line(cells))
    return "\n".join(lines)


def crowded(row: Row) -> str:
    """Return a remark if there are more threads than cores."""
    return "" if row["threads"] <= row["cores"] else f", on {row['cores']} cores"


def stages(axis: str, some: Sequence[Row]) -> str:
    """Return a sentence with the exponents of the slowest stages of the last row. It is empty for several workers."""
    some = [row for row in some if row["threads"] <= row["cores"]]
    if len(some) < 2 or axis == "workers":
        return ""
    last, found = some[-1], {}
    for name, seconds in last["seconds"].items():
        if seconds >= SHARE * last["seconds_total"]:
            slope = exponent([(number_of(axis, row), row["seconds"].get(name, 0.0)) for row in some])
            found[name] = f"{name} {_exponent(slope)} ({100 * seconds / last['seconds_total']:.0f} % of the last)"
    return f"Exponents of the seconds of stages, by {axis}: {', '.join(found.values())}." if found else ""


def memory(axis: str, some: Sequence[Row]) -> str:
    """Return a sentence on the growth of memory in the longest film; an empty one for other axes, and with too few groups."""
    groups = some[-1].get("memory_mb_by_group", []) if some and axis == "frames" else []
    if len(groups) < 3 or not groups[EARLY]:
        return ""
    late = min(LATE, len(groups) - 1)
    early, change = groups[EARLY], groups[late] / groups[EARLY] - 1
    most = max(groups[EARLY : late + 1])
    verdict = "within" if change <= ALLOWED else "more than"
    span = f"from group {EARLY + 1} to group {late + 1} of {some[-1]['frames']:,} frames"
    grown = f"{100 * change:+.1f} %, {verdict} the {100 * ALLOWED:.0f} % that it may grow by"
    return (
        f"Memory {span}: {early:,.0f} MB to {groups[late]:,.0f} MB, {grown}. From the one to the other, no group took more than "
        f"{most:,.0f} MB ({100 * (most / early - 1):+.1f} %)."
    )


def plot(by_axis: dict[str, list[Row]]) -> str:
    """Return an SVG with a column for each axis: time above, memory below."""
    lines = []
    for title, name in (("seconds", TIME), ("memory, MB", MEMORY)):
        panels = []
        for axis, some in by_axis.items():
            points = [(number_of(axis, row), row[name]) for row in some]
            labels = [f"({value_of(axis, row)})" if crowded(row) else value_of(axis, row) for row in some]
            note = f"exponent {_exponent(exponent(points_of(axis, some, name)))}"
            panels.append(Panel(AXES[axis], points, labels, note))
        lines.append((title, panels))
    return charts(lines)


def write(by_axis: dict[str, list[Row]], document: Path = PAGE, image: Path = PLOT) -> None:
    """Write the page and the plot.

    Raises:
        ValueError: The page lacks the markers.
    """
    document.write_text(replaced(document.read_text(encoding="utf-8"), page(by_axis)), encoding="utf-8")
    if any(by_axis.values()):
        image.write_text(plot(by_axis), encoding="utf-8")


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _exponent(value: float | None) -> str:
    return "not known" if value is None else f"{value:.2f}"
