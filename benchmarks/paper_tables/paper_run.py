"""One table or figure of the paper, measured and written in all formats."""

from __future__ import annotations

from pathlib import Path

from bench.rate_chart import line_chart
from paper_tables.paper_bench import FULL, INDEPENDENT, PaperBench
from paper_tables.paper_comparisons import COMPARISONS
from paper_tables.paper_images import IMAGES, write_figure
from paper_tables.paper_results import CODEC_TABLES, RESULTS, PaperResult, codec_table
from paper_tables.paper_table import PaperTable
from splatreel.base.errors import MissingDependencyError, UsageError
from splatreel.evaluation.report import write_text

TABLES: dict[str, PaperResult] = RESULTS | COMPARISONS
"""Tables of numbers by the value of --table."""
TITLES = {name: result.title for name, result in TABLES.items()} | {
    "4": "V3's compression and ours",
    "8": "ablation on model size",
    "9": "ablation on Gaussian point quantization",
    "10": "ablation on deformation encoding",
    **{name: image.title for name, image in IMAGES.items()},
}
"""Tables and figures that can be measured, by the value of --table."""


def variants_of(table: str) -> tuple[str, ...]:
    """Return the variants that a table needs.

    Raises:
        UsageError: The table cannot be measured.
    """
    if table not in TITLES:
        known = ", ".join(f"{name} ({TITLES[name]})" for name in sorted(TITLES, key=lambda name: (len(name), name)))
        raise UsageError(f"--table {table!r} is not one of: {known}.")
    if table in IMAGES:
        return tuple(IMAGES[table].variants)
    if table in CODEC_TABLES:
        return (FULL, INDEPENDENT) if table == "8" else (FULL,)
    return tuple(TABLES[table].variants)


def write_table(bench: PaperBench, table: str, every: int) -> str:
    """Measure a table, write OUT/table-N.md, and where it applies .csv, .tex, .svg and .png, and return the Markdown text.

    OUT/paper.jsonl gets the numbers of all reconstructions.

    Args:
        bench: Reconstructions.
        table: Key of `TITLES`.
        every: Distance of the frames that encodings are compared at.

    Raises:
        UsageError: The table cannot be measured.
    """
    variants_of(table)
    if table in IMAGES:
        text = write_figure(bench, table)
    else:
        place = bench.out / (f"table-{table}" if table[0].isdigit() else table)
        text = codec_table(bench, table, every) if table in CODEC_TABLES else _write_all_formats(bench, table, place)
        write_text(place.with_suffix(".md"), text)
    write_text(bench.out / "paper.jsonl", "".join(f"{line}\n" for line in bench.record()))
    return text


def _write_all_formats(bench: PaperBench, table: str, place: Path) -> str:
    """Write a table as CSV and LaTeX, and its chart. Return its Markdown text."""
    found = TABLES[table].table(bench)
    write_text(place.with_suffix(".csv"), found.to_csv())
    write_text(place.with_suffix(".tex"), found.to_latex())
    text = found.to_markdown()
    if table in CHARTS:
        try:
            write_text(place.with_suffix(".svg"), CHARTS[table](found))
        except MissingDependencyError as error:
            text += f"\n{place.with_suffix('.svg').name} was not drawn. {error}\n"
    return text


def _curves(table: PaperTable) -> str:
    """Draw the columns of a table over its first column."""
    series = {
        name: [(float(row[0]), float(row[place])) for row in table.rows]
        for place, name in enumerate(table.heads)
        if place
    }
    return line_chart(series, table.caption, table.heads[0], "PSNR, dB")


def _points(table: PaperTable) -> str:
    """Draw a point for each row of method, megabytes and PSNR."""
    return line_chart(
        {row[0]: [(float(row[1]), float(row[2]))] for row in table.rows}, "Figure 15", "megabytes", "PSNR, dB", "log"
    )


CHARTS = {"figure10": _curves, "figure15": _points}
"""Functions that draw a table, by its number."""
