"""Write the tables in README.md and docs (results, inputs, paper-tables, player, decoder) from the latest record of each benchmark.

python benchmarks/table.py
"""

import json
import statistics
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from string import ascii_lowercase

from document import replaced_between
from player_tables import decoder_table, frame_table, loop_table
from record import RESULTS, ROOT

README = ROOT / "README.md"
PAGE = ROOT / "docs" / "results.md"
PAPER_PAGE = ROOT / "docs" / "paper-tables.md"
INPUTS_PAGE = ROOT / "docs" / "inputs.md"
PLAYER_PAGE = ROOT / "docs" / "player.md"
DECODER_PAGE = ROOT / "docs" / "decoder.md"
BEGIN, END = "<!-- results: written by benchmarks/table.py -->", "<!-- end of results -->"
replaced = partial(replaced_between, BEGIN, END)
"""Function from a document and a text to the document with the text between its markers."""
MISSING = "*not measured*"

ROWS = {
    "demo trajectory": "built-in capture",
    "demo hashgrid": "built-in capture, the paper's hash grid",
    "basketball 320": "Panoptic basketball, 320 wide",
    "basketball 640": "Panoptic basketball, 640 wide",
    "dominoes": "dominoes: a ring of cameras, fast and small",
    "juggle": "juggle: a dome of cameras, three identical balls, a swinging bat",
    "studio": "studio: twenty phones out of sync, changing exposures",
    "cove": "cove: a dancer before white walls",
    "kitchen": "kitchen: cameras on one side, distant view in a window",
    "yard": "yard: outdoors, ten training cameras",
    "hearth": "hearth: fire, steam, poured water, a screen with cuts",
}
"""Benchmarks that always have a row, measured or not. Those of single frames get one when they have been recorded."""
SEQUENCE = "sequence independently trained"
"""Benchmark of `benchmarks/importing.py --train`, an imported film beside other formats."""
PAPER = "paper"
"""First word of the benchmarks of `benchmarks/paper.py`, which is followed by the number of a table."""
ORACLE, ON_ITS_OWN = "oracle", "each frame on its own"
"""The benchmark of single frames: first word of its name, which is followed by a capture's and a width."""

COLUMNS = (
    "held-out cameras of",
    "frames",
    "PSNR dB",
    "per channel",
    "colors fitted",
    "SSIM",
    "LPIPS",
    "before encoding",
    "reel",
    "of float32",
)
COLUMNS += ("time", "load before", "memory", "commit")
SHORT_ROWS = ("demo trajectory", "basketball 320", "basketball 640", "studio", "cove", "kitchen", "yard")
SHORT_COLUMNS = ("held-out cameras of", "frames", "PSNR dB", "SSIM", "LPIPS", "reel")
"""Rows and columns of the README. Times are on the page, beside the load of the machine."""


def latest(results: Path = RESULTS) -> dict[str, dict]:
    """Return the last record of each benchmark by name; empty if nothing was recorded.

    If the benchmark was run with several seeds at the revision of this record, `seeds` lists the last record of each seed.
    """
    lines = results.read_text(encoding="utf-8").splitlines() if results.exists() else []
    records = [json.loads(line) for line in lines if line.strip()]
    found = {record["benchmark"]: record for record in records}
    for name, last in found.items():
        same = [r for r in records if (r["benchmark"], r["revision"]) == (name, last["revision"])]
        seeds = {record.get("seed", 0): record for record in same}
        if len(seeds) > 1:
            found[name] = last | {"seeds": [seeds[seed] for seed in sorted(seeds)]}
    return found


def table(records: dict[str, dict]) -> str:
    """Return the page's Markdown table, and the machines that it was measured on."""
    single = {name: name.split() for name in sorted(records) if name.split()[0] == ORACLE}
    rows = ROWS | {name: f"{words[1]}, {words[2]} wide, {ON_ITS_OWN}" for name, words in single.items()}
    lines = _lines(records, rows, COLUMNS)
    measured = [records[name] for name in rows if name in records]
    machines = sorted({_machine(record)[0] for record in measured})
    if machines:
        lines += ["", f"Measured on {'; '.join(machines)}."]
    return "\n".join(lines + _seed_note(records[name] for name in rows if name in records))


def short_table(records: dict[str, dict]) -> str:
    """Return the README's Markdown table: some rows and columns of the page's table."""
    lines = _lines(records, {name: ROWS[name] for name in SHORT_ROWS}, SHORT_COLUMNS)
    return "\n".join(lines + _seed_note(records[name] for name in SHORT_ROWS if name in records))


def _seed_note(records: Iterable[dict]) -> list[str]:
    """Return lines that explain `±`, if a record has several seeds."""
    counts = sorted({len(record["seeds"]) for record in records if "seeds" in record})
    if not counts:
        return []
    return [
        "",
        f"± is the standard deviation over {' or '.join(map(str, counts))} seeds. Rows without it are of one seed.",
    ]


UNDRAWN = {name: f"\n{name}.svg was not drawn." for name in ("figure10", "figure15")}
"""Start of the note about a chart that could not be drawn, which some records end with."""


def paper_tables(records: dict[str, dict]) -> str:
    """Return the paper's tables in the order of their numbers, and what they were measured on."""
    found = {name.split()[1]: record for name, record in records.items() if name.split()[0] == PAPER}
    labels = {name: _paper_label(record) for name, record in found.items()}
    usual = statistics.mode(labels.values()) if labels else ""
    parts = [f"{usual} This holds for all tables that say nothing else.", ""] if len(found) > 1 else []
    for name in sorted(found, key=lambda name: (not name.isdigit(), int(name.strip(ascii_lowercase) or 0))):
        title = f"Table {name}" if name.isdigit() else name.replace("figure", "Figure ").capitalize()
        text = found[name]["markdown"]
        text = text.partition(UNDRAWN[name])[0] if name in UNDRAWN else text
        parts += [f"## {title}", "", text.strip(), ""]
        parts += [labels[name], ""] if labels[name] != usual or len(found) == 1 else []
    return "\n".join(parts).strip()


def _paper_label(record: dict) -> str:
    """Return the sentence that says on what a table of the paper was measured."""
    shapes = ", ".join(f"{name} ({shape})" for name, shape in record["captures"].items())
    settings = "".join(f", `{setting}`" for setting in record.get("settings", []))
    return f"Measured at `{record['quality']}`{settings} on {shapes}; commit `{record['revision']}`."


def sequence_table(records: dict[str, dict]) -> str:
    """Return the Markdown table of an imported film beside other formats."""
    record = records.get(SEQUENCE)
    if record is None:
        return MISSING
    columns = ("format", "KB per frame", "PSNR, dB", "reel at that PSNR, KB", "share")
    lines = [_row(columns), _row(["---"] * len(columns))]
    for name, found in record["formats"].items():
        size, same = found["bytes_per_frame"], found.get("reel_at_that_psnr")
        beside = ("", "") if same is None else (f"{same / 1000:.0f}", f"{100 * same / size:.0f} %")
        lines.append(_row((name, f"{size / 1000:.0f}", f"{found['psnr']:.1f}", *beside)))
    measured = f"{record['frames']} frames of {record['points']:,} points; commit `{record['revision']}`."
    return "\n".join([*lines, "", measured])


def _lines(records: dict[str, dict], rows: dict[str, str], columns: tuple[str, ...]) -> list[str]:
    """Return the lines of a table. A metric that older records lack, or that needs weights, has a column as soon as a row has it."""
    optional = {"LPIPS": "lpips", "colors fitted": "psnr_color_fitted"}
    missing = {name for name, key in optional.items() if all(record.get(key) is None for record in records.values())}
    columns = tuple(column for column in columns if column not in missing)
    cells = (_cells(label, records.get(name)) for name, label in rows.items())
    body = [_row(by_column[column] for column in columns) for by_column in cells]
    return [_row(columns), _row(["---"] * len(columns)), *body]


def _row(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _cells(label: str, record: dict | None) -> dict[str, str]:
    """Return the cells of a record by column."""
    if record is None:
        return dict(zip(COLUMNS, [label, *[MISSING] * (len(COLUMNS) - 1)], strict=True))
    cells = (
        label,
        f"{record['frames']} at {record['width']}x{record['height']}",
        _number(record, "psnr", ".2f"),
        _number(record, "psnr_per_channel", ".2f"),
        _number(record, "psnr_color_fitted", ".2f"),
        _number(record, "ssim", ".4f"),
        _number(record, "lpips", ".4f"),
        _number(record, "psnr_undecoded", ".2f"),
        _number(record, "reel_bytes", ".2f", 1e-6, " MB"),
        _number(record, "share_of_float32", ".1f", 100, " %"),
        _number(record, "seconds_total", ".1f", 1 / 60, " min"),
        _machine(record)[1] or MISSING,
        _number(record, "peak_memory_bytes", ".1f", 1e-9, " GB"),
        f"`{record['revision']}`",
    )
    return dict(zip(COLUMNS, cells, strict=True))


def _machine(record: dict) -> tuple[str, str]:
    """Return the machine of a record, and its load before."""
    machine, _, load = str(record.get("machine_before", record["machine"])).partition(", load ")
    return machine, load


def _number(record: dict, name: str, style: str, factor: float = 1, unit: str = "") -> str:
    """Return the number of a record, or the mean and the standard deviation of its seeds."""
    values = [one.get(name) for one in record.get("seeds", [record])]
    known = [value * factor for value in values if value is not None]
    if len(known) < len(values):
        return MISSING
    spread = f" ± {statistics.stdev(known):{style}}" if len(known) > 1 else ""
    return f"{statistics.fmean(known):{style}}{spread}{unit}"


def documents(records: dict[str, dict]) -> dict[Path, str]:
    """Return the text that belongs between the markers of each document."""
    return {
        README: short_table(records),
        PAGE: table(records),
        INPUTS_PAGE: sequence_table(records),
        PAPER_PAGE: paper_tables(records),
        PLAYER_PAGE: f"{frame_table(records)}\n\n{loop_table(records)}",
        DECODER_PAGE: decoder_table(records),
    }


def write(records: dict[str, dict]) -> None:
    """Write the tables into the documents."""
    for document, inner in documents(records).items():
        document.write_text(replaced(document.read_text(encoding="utf-8"), inner), encoding="utf-8")


if __name__ == "__main__":
    latest_records = latest()
    write(latest_records)
    print(table(latest_records))
