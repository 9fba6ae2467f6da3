"""Where the time of a run goes, function by function."""

from __future__ import annotations

import cProfile
import pstats
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from splatreel.evaluation.report import write_text

MIN_SHARE = 0.005
"""Share of the whole below which a function is not listed."""

Calls = dict[tuple[str, int, str], tuple[int, int, float, float, dict]]
"""By file, line and name: calls, also recursive ones, own and total seconds, callers."""


@contextmanager
def profiled(path: Path | None) -> Iterator[None]:
    """Measures what runs inside, on this thread, and writes the table to path, whatever is raised; nothing where path is None.

    Measuring takes about a tenth more time. Work on a GPU runs on behind the functions that asked for it, and is found where one waits.
    """
    if path is None:
        yield
        return
    profile = cProfile.Profile()
    profile.enable()
    try:
        yield
    finally:
        profile.disable()
        if path.parent.is_dir():  # else nothing was begun
            write_text(path, table(pstats.Stats(profile).stats))  # pyright: ignore[reportAttributeAccessIssue]


def table(calls: Calls) -> str:
    """Markdown: the functions that most time is spent in themselves, the longest first."""
    whole = sum(own for _, _, own, _, _ in calls.values()) or 1.0
    lines = ["| share | seconds | calls | ms a call | with what it calls, s | function |", "|---|---|---|---|---|---|"]
    for (file, line, name), (_, count, own, total, _) in sorted(calls.items(), key=lambda item: -item[1][2]):
        if own >= MIN_SHARE * whole:
            place = f"`{name}`" if file == "~" else f"`{_short(file)}:{line}` `{name}`"
            numbers = f"{own / whole:.1%} | {own:.2f} | {count:,} | {1000 * own / count:.3f} | {total:.2f}"
            lines.append(f"| {numbers} | {place} |")
    return "\n".join([f"{whole:.1f} s on the main thread.", "", *lines, ""])


def _short(file: str) -> str:
    """The path from the package on, or the file's own name."""
    parts = Path(file).parts
    return "/".join(parts[len(parts) - parts[::-1].index("splatreel") :]) if "splatreel" in parts else Path(file).name
