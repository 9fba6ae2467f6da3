"""Measure the paper's tables on captures, and record them for docs/paper-tables.md.

python benchmarks/paper.py BUILTIN basketball kitchen --out OUT --quality draft, then python benchmarks/table.py
"""

import json
from contextlib import closing
from pathlib import Path
from typing import Annotated

import tyro
from paper_tables.paper_bench import PaperBench
from paper_tables.paper_pictures import PICTURES
from paper_tables.paper_run import TITLES, write_table
from splatreel.base.display import console

from record import record
from splatreel.base.process import keep_freed_memory
from splatreel.capture.opening import open_capture
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
    frames: int | None = None,
    every: int = 4,
    set: Names = (),
    minutes: float | None = None,
    note: str = "",
) -> None:
    """Measure tables and append one record for each.

    Args:
        captures: Folders of the captures; their names stand in the tables.
        out: Folder of the reconstructions, which all tables share.
        quality: Preset of settings.
        table: Number of a table; may be repeated. By default all.
        width: Width of the images, in pixels, at most; narrower captures keep theirs.
        frames: Number of frames, at most.
        every: Distance of the frames that encodings are compared at.
        set: Setting as NAME=VALUE; may be repeated.
        minutes: Minutes that each baseline trains; by default as many as ours took.
        note: Note in the record.
    """
    keep_freed_memory()  # as the command line does
    sources = {}
    for path in captures:
        with closing(open_capture(path)) as source:
            wide, long = min(width or source.width, source.width), min(frames or source.frames, source.frames)
        sources[path.name] = open_capture(path, width=wide, frames=(0, long))
    progress = console()
    try:
        bench = PaperBench(sources, changed(preset(quality), parse_settings(set)), out, "auto", progress, minutes)
        for number in table or [name for name in TITLES if name not in PICTURES]:
            text = write_table(bench, number, every)
            shapes = {name: f"{s.frames} at {s.width}x{s.height}" for name, s in sources.items()}
            values = {"captures": shapes, "quality": quality, "settings": list(set), "markdown": text}
            if number not in PICTURES:
                record(f"paper {number}", {**values, "runs": [json.loads(line) for line in bench.record()]}, note)
            print(text)
    finally:
        progress.close()


if __name__ == "__main__":
    tyro.cli(main)
