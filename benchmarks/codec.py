"""Bytes against quality of all codec configurations on one reconstruction, and the paper's tables of it, recorded.

python benchmarks/codec.py out/demo out/demo/capture
"""

import dataclasses
from pathlib import Path

import tyro

from record import record
from splatreel.capture.opening import open_capture
from splatreel.evaluation.bench.paper_tables import paper_tables
from splatreel.evaluation.bench.rate_distortion import Sweep, bd_rate, curves, rate_distortion_points, sweep_of, table
from splatreel.evaluation.evaluate import reel_width
from splatreel.progress import Silent


def main(
    run: tyro.conf.Positional[Path],
    capture: tyro.conf.Positional[Path],
    /,
    name: str = "demo",
    every: int = 4,
    first: int = 0,
    end: int | None = None,
    only: tuple[str, ...] = (),
    tables: bool = True,
    lines: Path | None = None,
    note: str = "",
) -> None:
    """name: what the reconstruction is of. first, end: the frames it was made from. only: configurations, all by default.

    lines: file of rows that were measured already, and gets the new ones.
    """
    span = None if end is None else (first, end)
    source = open_capture(capture, width=reel_width(run / "reel"), frames=span)
    sweep = sweep_of(run, source, every, record=lines)
    rows = rate_distortion_points(sweep, list(only) or None)
    paper, ours = curves(rows).values()
    values = {"every": every, "bd_rate": bd_rate(paper, ours), "rows": [dataclasses.asdict(row) for row in rows]}
    print(table(rows))
    if tables:
        values["tables"] = paper_tables(sweep, Sweep(run, source, [0], Silent(), lines))
        print(values["tables"])
    record(f"codec {name}", values, note)


if __name__ == "__main__":
    tyro.cli(main)
