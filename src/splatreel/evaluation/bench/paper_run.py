"""One table or figure of the paper, measured and written in all formats."""

from __future__ import annotations

from pathlib import Path

from splatreel.errors import MissingDependencyError, UsageError
from splatreel.evaluation.bench.paper_bench import FULL, PaperBench
from splatreel.evaluation.bench.paper_results import CODEC_TABLES, RESULTS, codec_table
from splatreel.evaluation.bench.paper_table import PaperTable
from splatreel.evaluation.bench.rate_chart import line_chart
from splatreel.evaluation.report import write_text

TITLES = {name: result.title for name, result in RESULTS.items()} | {
    "4": "V3's compression and ours",
    "8": "ablation on model size",
    "9": "ablation on Gaussian point quantization",
    "10": "ablation on deformation encoding",
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
    return (FULL,) if table in CODEC_TABLES else tuple(RESULTS[table].variants)


def write_table(bench: PaperBench, table: str, every: int) -> str:
    """Measure a table, write OUT/table-N.md, and where it applies .csv, .tex and .svg, and return the Markdown text.

    OUT/paper.jsonl gets the numbers of all reconstructions.

    Args:
        bench: Reconstructions.
        table: Key of `TITLES`.
        every: Distance of the frames that encodings are compared at.

    Raises:
        UsageError: The table cannot be measured.
    """
    variants_of(table)
    place = bench.out / (table if table.startswith("figure") else f"table-{table}")
    if table in CODEC_TABLES:
        text = codec_table(bench, table, every)
    else:
        found = RESULTS[table].table(bench)
        text = found.to_markdown()
        write_text(place.with_suffix(".csv"), found.to_csv())
        write_text(place.with_suffix(".tex"), found.to_latex())
        if table.startswith("figure"):
            text += _drawn(place.with_suffix(".svg"), found)
    write_text(place.with_suffix(".md"), text)
    write_text(bench.out / "paper.jsonl", "".join(f"{line}\n" for line in bench.record()))
    return text


def _drawn(path: Path, table: PaperTable) -> str:
    """Draw the columns of a table over its first column. Return a sentence if that is not possible."""
    series = {
        name: [(float(row[0]), float(row[place])) for row in table.rows]
        for place, name in enumerate(table.heads)
        if place
    }
    try:
        write_text(path, line_chart(series, table.caption, table.heads[0], "PSNR, dB"))
    except MissingDependencyError as error:
        return f"\n{path} was not drawn. {error}\n"
    return ""
