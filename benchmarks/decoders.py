"""Measure decoders without a renderer: ours in Node, fourdgs, and SPZ files per frame: python benchmarks/decoders.py --help."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

from record import ROOT, record
from splatreel.play.timeline import open_reel

HERE = Path(__file__).parent / "decoders"
PLAYER = ROOT / "player"
DECODER = PLAYER / "packages" / "decoder" / "dist" / "node.js"
"""Built by npm run build --workspace @splatreel/decoder, in player/."""
SPZ_LOADER = PLAYER / "node_modules" / "three" / "examples" / "jsm" / "loaders" / "SPZLoader.js"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("reel", type=Path, help="a reel's folder")
    parser.add_argument("--rounds", type=int, default=3, help="how often all readers take their turn")
    parser.add_argument("--record", metavar="NOTE", help="append to benchmarks/results.jsonl")
    arguments = parser.parse_args()
    manifest = open_reel(arguments.reel).manifest
    with tempfile.TemporaryDirectory() as name:
        film, frames = Path(name) / "film.4dgs", Path(name) / "spz"
        for command in (["--out", str(film)], ["--out", str(frames), "--format", "spz"]):
            export = [sys.executable, "-m", "splatreel", "export", str(arguments.reel), *command]
            subprocess.run(export, check=True, stdout=subprocess.DEVNULL)
        readers = {
            "@splatreel/decoder": ["node", HERE / "reel.mjs", DECODER, arguments.reel],
            "fourdgs": [sys.executable, HERE / "fourdgs_file.py", film, str(manifest.frames), str(manifest.fps)],
            "SPZ per frame, three.js": ["node", HERE / "spz.mjs", SPZ_LOADER, frames],
        }
        sizes = [bytes_of(arguments.reel / "layers", arguments.reel / "groups"), film.stat().st_size, bytes_of(frames)]
        runs = {name: [] for name in readers}
        for _ in range(arguments.rounds):
            for name, command in readers.items():
                output = subprocess.run(command, check=True, capture_output=True, text=True).stdout
                runs[name].append(json.loads(output))
    groups = len(manifest.groups)
    for (name, found), size in zip(runs.items(), sizes, strict=True):
        best = {key: min(run[key] for run in found) for key in found[0]}
        values = {"frames": manifest.frames, "groups": groups, "file_bytes": size, "memory_bytes": best["memory_bytes"]}
        values |= {f"{key}_per_group": round(best[key] / groups, 1) for key in ("decode_ms", "all_ms")}
        print(json.dumps({"reader": name} | values), flush=True)
        if arguments.record is not None:
            record(f"decoder {name}", values, arguments.record)


def bytes_of(*folders: Path) -> int:
    """Return the bytes of all files in folders."""
    return sum(path.stat().st_size for folder in folders for path in folder.rglob("*") if path.is_file())


if __name__ == "__main__":
    main()
