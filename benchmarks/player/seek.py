"""Measure the time from a seek to its frame in a reel of hours: benchmarks/player/seek.py REEL --groups 10000.

The long reel is the given one again and again: each time is a chapter, whose layers are retired with it. Its files are links.
With --groups 0 the given reel is played as it is.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import shutil
import statistics
import sys
import tempfile
from pathlib import Path

from http_folder import Line, serve_folder
from playwright.sync_api import sync_playwright
from start import opened

from run import FLAGS, STATIC, chromium

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from record import record
from splatreel.codec.manifest import PAGE, FileEntry, Manifest, make_page
from splatreel.codec.reader import ReelReader

NEAR, FAR = 12, 7 * PAGE
"""Groups from one seek to the next: nothing of it is buffered. At the beginning they are in a page that is here, at the end each is in
one that is not."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "reel", type=Path, help="a reel's folder; of one chapter and without renditions, unless --groups 0"
    )
    parser.add_argument("--groups", type=int, default=10_000)
    parser.add_argument("--size", type=int, nargs=2, default=[640, 360], metavar=("WIDTH", "HEIGHT"))
    parser.add_argument("--mbit", type=float, default=float("inf"), help="of the network, Mbit/s")
    parser.add_argument("--latency", type=float, default=0.0, help="of every answer, seconds")
    parser.add_argument("--times", type=int, default=5, help="seeks at either end")
    parser.add_argument("--gpu", action="store_true", help="let the browser use the graphics device")
    parser.add_argument("--record", metavar="NOTE", help="append to benchmarks/results.jsonl")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name, sync_playwright() as driver:
        folder = Path(name)
        shutil.copytree(STATIC, folder, dirs_exist_ok=True)
        reel = arguments.reel.resolve()
        if arguments.groups:
            manifest = write_long(reel, folder / "reel", arguments.groups)
        else:
            (folder / "reel").symlink_to(reel)
            manifest = ReelReader(reel).manifest
        count = len(manifest.groups)
        far = min(FAR, count // (2 * arguments.times))
        flags = FLAGS if arguments.gpu else [*FLAGS, "--disable-gpu"]
        browser = driver.chromium.launch(executable_path=chromium(), args=flags)
        with serve_folder(folder, Line(arguments.mbit, arguments.latency)) as url:
            page = opened(browser, url, arguments)
            steps = range(1, arguments.times + 1)
            asked = {"start": [NEAR * i for i in steps], "end": [count - far * i for i in steps]}
            found = {
                f"{where}_ms": [page.evaluate(f"window.seek({time_of(manifest, group)})") for group in groups]
                for where, groups in asked.items()
            }
        browser.close()
    values: dict = {name: statistics.median(times) for name, times in found.items()}
    values |= {
        "groups": count,
        "mbit": min(arguments.mbit, 1e6),
        "latency_ms": round(1000 * arguments.latency),
    }
    print(json.dumps(values | {"runs": found}), flush=True)
    if arguments.record is not None:
        record("player seek", values, arguments.record)


def write_long(source: Path, target: Path, count: int) -> Manifest:
    """Write a reel of this many groups into a folder."""
    reel = ReelReader(source).manifest
    for kind in ("layers", "groups", "pages"):
        (target / kind).mkdir(parents=True)
    chapter = len(reel.groups)
    length = reel.groups[-1].end - reel.overlap
    layers, groups = [], []
    for begin in range(0, count, chapter):
        shift = begin // chapter * length
        moved = [again(entry, begin, shift, chapter, source, target) for entry in (*reel.layers, *reel.groups)]
        layers += moved[: len(reel.layers)]
        groups += moved[len(reel.layers) :]
    groups = groups[:count]
    made = [make_page(layers, groups[i * PAGE :][:PAGE], ()) for i in range(max(count // PAGE - 1, 0))]
    for entry, data in made:
        (target / entry.uri).write_bytes(data)
    whole = reel.with_files([layer for layer in layers if layer.group < count], groups)
    manifest = dataclasses.replace(whole, pages=tuple(entry for entry, _ in made))
    (target / "manifest.json").write_text(manifest.to_json())
    return manifest


def again(entry: FileEntry, begin: int, shift: int, chapter: int, source: Path, target: Path) -> FileEntry:
    """Return a file's entry in the chapter that begins with a group, `shift` frames later."""
    uri = f"{Path(entry.uri).parent}/{begin + entry.group:06d}.safetensors"
    (target / uri).symlink_to(source / entry.uri)
    until = None if entry.frames else begin + chapter
    return dataclasses.replace(
        entry, uri=uri, first_frame=entry.first_frame + shift, group=begin + entry.group, until=until
    )


def time_of(manifest: Manifest, group: int) -> float:
    """Return the middle of a group in seconds."""
    entry = manifest.groups[group]
    return (entry.first_frame + entry.frames / 2) / manifest.fps


if __name__ == "__main__":
    main()
