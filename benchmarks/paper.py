"""Measure tables and figures of the paper on captures: reconstruct each capture in all variants, and average as the paper does.

python benchmarks/paper.py CAPTURE --out OUT --table 6 measures one table of your capture. The same command continues. Tables share
reconstructions; tables 4, 8, 9 and 10 encode one of them in several ways. Without --table all tables are measured. Each is written
to OUT. With --record it is also appended to benchmarks/results.jsonl, of which python benchmarks/table.py makes docs/paper-tables.md.
"""

import json
import math
import sys
from contextlib import closing
from pathlib import Path
from typing import Annotated

import tyro

from paper_tables.paper_bench import PaperBench
from paper_tables.paper_images import IMAGES
from paper_tables.paper_run import TITLES, variants_of, write_table
from record import RESULTS, record
from splatreel.base.display import console
from splatreel.base.errors import SplatreelError, UsageError
from splatreel.base.process import keep_freed_memory
from splatreel.capture.opening import open_capture
from splatreel.cli.options import parse_frames
from splatreel.cli.reconstruct import Device
from splatreel.config import Quality, preset
from splatreel.config.settings import changed, parse_settings

Names = Annotated[tuple[str, ...], tyro.conf.UseAppendAction]


def main(
    captures: tyro.conf.Positional[tuple[Path, ...]],
    /,
    out: Path,
    quality: Quality = "standard",
    table: Names = (),
    width: int | None = None,
    frames: str | None = None,
    every: int = 4,
    set: Names = (),
    minutes: float | None = None,
    estimate: bool = False,
    device: Device = "auto",
    seed: int = 0,
    record_: Annotated[bool, tyro.conf.arg(name="record")] = False,
    note: str = "",
) -> None:
    """Measure tables of the paper.

    Args:
        captures: Folders of the captures; their names stand in the tables.
        out: OUT/table-N.md gets a table, .csv and .tex the same for other programs; OUT/results.jsonl gets a record of each table;
            OUT/CAPTURE gets the reconstructions.
        quality: Preset of settings.
        table: 1 to 10, 12, 13, 14 (as Tables 14 to 17), baselines, figure7 to 12 or figure15; by default all. May be repeated.
        width: Width of the images, in pixels, at most; narrower captures keep theirs.
        frames: Frames A to B - 1, as A:B; by default all. Shorter captures end earlier.
        every: Distance of the frames that encodings are compared at.
        set: Setting as NAME=VALUE; may be repeated.
        minutes: Minutes that each baseline trains, our first keyframe included; by default as many as ours took.
        estimate: Only estimate time and memory. Nothing is written.
        device: Device that trains; auto uses a GPU if there is one.
        seed: Seed of all random numbers.
        record_: Also append the records to those of this project, benchmarks/results.jsonl.
        note: Note in the record.
    """
    keep_freed_memory()  # as the command line does
    names = [path.resolve().name for path in captures]
    if every < 1 or len({*names}) < len(names) or not names:
        raise UsageError("benchmarks/paper.py needs captures with different folder names, and --every 1 or more.")
    if minutes is not None and not 0 < minutes < math.inf:
        raise UsageError(f"--minutes {minutes:g} is out of range. Choose more than 0.")
    variants = {number: variants_of(number) for number in table or [name for name in TITLES if name not in IMAGES]}
    sources, span = {}, parse_frames(frames)
    for name, path in zip(names, captures, strict=True):
        with closing(open_capture(path)) as source:
            wide, (first, end) = min(width or source.width, source.width), span or (0, source.frames)
            end = max(min(end, source.frames), first + 1)
        sources[name] = open_capture(path, width=wide, frames=(first, end))
    config = changed(preset(quality), parse_settings(set) | {"seed": seed})
    progress = console()
    try:
        bench = PaperBench(sources, config, out, device, progress, minutes)
        plan = bench.plan(tuple(dict.fromkeys(name for found in variants.values() for name in found)))
        if estimate:
            return print(plan)
        progress.note(plan)
        for number in variants:
            text = write_table(bench, number, every)
            shapes = {name: f"{s.frames} at {s.width}x{s.height}" for name, s in sources.items()}
            values = {"captures": shapes, "quality": quality, "settings": list(set), "markdown": text}
            if number not in IMAGES:
                values["runs"] = [json.loads(line) for line in bench.record()]
                for results in (out / "results.jsonl", *([RESULTS] if record_ else [])):
                    record(f"paper {number}", values, note, results)
            print(text)
    finally:
        progress.close()
        for source in sources.values():
            source.close()


if __name__ == "__main__":
    try:
        tyro.cli(main)
    except SplatreelError as error:
        sys.exit(f"Error: {error}")
