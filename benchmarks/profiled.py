"""Run a `splatreel` command and write which functions take its time.

python benchmarks/profiled.py OUT/profile.md reconstruct CAPTURE --out OUT
"""

import cProfile
import pstats
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from splatreel.cli.main import main
from splatreel.evaluation.report import write_text

MIN_SHARE = 0.005
"""Functions below this share of the total time are not listed."""

Calls = dict[tuple[str, int, str], tuple[int, int, float, float, dict]]
"""Statistics by file, line and name: calls, calls including recursion, own seconds, total seconds, callers."""


@contextmanager
def profiled(path: Path) -> Iterator[None]:
    """Profile this thread inside the `with` block and write the table to a file, also after an exception.

    Profiling takes about a tenth more time. GPU work runs asynchronously and appears in the function that waits for it.

    Args:
        path: Output file.
    """
    profile = cProfile.Profile()
    profile.enable()
    try:
        yield
    finally:
        profile.disable()
        if path.parent.is_dir():  # otherwise the run never started
            write_text(path, table(pstats.Stats(profile).stats))  # pyright: ignore[reportAttributeAccessIssue]


def table(calls: Calls) -> str:
    """Return a Markdown table of the functions with the most own time, in descending order."""
    whole = sum(own for _, _, own, _, _ in calls.values()) or 1.0
    lines = ["| share | seconds | calls | ms a call | with what it calls, s | function |", "|---|---|---|---|---|---|"]
    for (file, line, name), (_, count, own, total, _) in sorted(calls.items(), key=lambda item: -item[1][2]):
        if own >= MIN_SHARE * whole:
            place = f"`{name}`" if file == "~" else f"`{_short(file)}:{line}` `{name}`"
            numbers = f"{own / whole:.1%} | {own:.2f} | {count:,} | {1000 * own / count:.3f} | {total:.2f}"
            lines.append(f"| {numbers} | {place} |")
    return "\n".join([f"{whole:.1f} s on the main thread.", "", *lines, ""])


def _short(file: str) -> str:
    """Return the path from the package on, or the file's name."""
    parts = Path(file).parts
    return "/".join(parts[len(parts) - parts[::-1].index("splatreel") :]) if "splatreel" in parts else Path(file).name


if __name__ == "__main__":
    with profiled(Path(sys.argv[1])):
        status = main(sys.argv[2:])
    sys.exit(status)
