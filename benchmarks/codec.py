"""Bytes against quality of all codec configurations on one reconstruction, recorded.

python benchmarks/codec.py out/demo out/demo/capture
"""

import dataclasses
from pathlib import Path

import tyro

from record import record
from splatreel.capture.opening import open_capture
from splatreel.evaluation.evaluate import reel_width
from splatreel.evaluation.rates import rate_distortion, table


def main(
    run: tyro.conf.Positional[Path],
    capture: tyro.conf.Positional[Path],
    /,
    name: str = "demo",
    every: int = 4,
    first: int = 0,
    end: int | None = None,
    only: tuple[str, ...] = (),
    note: str = "",
) -> None:
    """name: what the reconstruction is of. first, end: the frames it was made from. only: configurations, all by default."""
    span = None if end is None else (first, end)
    source = open_capture(capture, width=reel_width(run / "reel"), frames=span)
    rows = rate_distortion(run, source, every=every, names=list(only) or None)
    record(f"codec {name}", {"every": every, "rows": [dataclasses.asdict(row) for row in rows]}, note)
    print(table(rows))


if __name__ == "__main__":
    tyro.cli(main)
