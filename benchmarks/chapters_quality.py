"""What chapters cost: a capture as one sequence of groups, and again as chapters that start each on its own.

python benchmarks/chapters_quality.py CAPTURE --width 160 --frames 0:60 --chapter-frames 30 --quality draft

Without CAPTURE it films the built-in one. The same command goes on where it was interrupted: each of the two has a folder of its own.
"""

import dataclasses
from pathlib import Path
from typing import Any

import tyro

from ablation import measured
from record import machine, record
from splatreel.capture.base import Capture
from splatreel.capture.builtin.synthetic import make_capture
from splatreel.capture.opening import open_capture
from splatreel.cli.main import keep_freed_memory
from splatreel.cli.options import parse_frames, parse_names
from splatreel.codec.reader import ReelReader
from splatreel.config import Quality, preset
from splatreel.evaluation.evaluate import evaluate
from splatreel.progress import console
from splatreel.recon.pipeline import reconstruct

GOALS = {"psnr": -0.15, "psnr_moving": -0.3}
"""dB that chapters may lose."""
MORE_BYTES = 0.1
"""Share by which they may be larger."""


def main(
    capture: tyro.conf.Positional[Path | None] = None,
    /,
    width: int | None = None,
    frames: str = "0:60",
    chapter_frames: int = 30,
    quality: Quality = "standard",
    hold_out: str | None = None,
    seed: int = 0,
    out: Path | None = None,
    note: str = "",
) -> None:
    """Reconstruct twice, evaluate, record, and print the table. hold_out: as of `splatreel reconstruct`."""
    keep_freed_memory()
    out = out or Path(f"out/chapters-{capture.name if capture else 'builtin'}-{width}-{quality}")
    span = parse_frames(frames) or (0, 60)
    path = capture or make_capture(out / "capture", frames=span[1])
    source = open_capture(path, width=width, frames=span, held_out=parse_names(hold_out, "--hold-out"))
    found = {}
    for name, length in (("sequence", 0), ("chapters", chapter_frames)):
        found[name] = values = once(source, out / name, quality, length, seed)
        record(f"chapters {source.name} {source.width} {quality}, {name} of {frames}", values, note)
    print(table(found["sequence"], found["chapters"]))


def once(source: Capture, out: Path, quality: Quality, chapter_frames: int, seed: int) -> dict[str, Any]:
    """One line of results.jsonl; chapter_frames: 0 for a sequence."""
    config = dataclasses.replace(preset(quality), seed=seed, chapter_frames=chapter_frames)
    before, progress = machine(), console()
    try:
        result = reconstruct(source, out, config, sound="none", progress=progress)
        report = evaluate(result.reel, source, out=out, progress=progress)
    finally:
        progress.close()
    manifest = ReelReader(result.reel).manifest
    return measured(result, source) | {
        "psnr": report.psnr,
        "ssim": report.ssim,
        "flicker": report.flicker,
        "flicker_borders": report.flicker_borders,
        "chapter_frames": chapter_frames,
        "dynamic": [group.points for group in manifest.groups],
        "group_bytes": [group.bytes for group in manifest.groups],
        "layers": [[layer.group, layer.points, layer.bytes] for layer in manifest.layers],
        "seconds": result.seconds,
        "seed": seed,
        "machine_before": before,
    }


def table(sequence: dict[str, Any], chapters: dict[str, Any]) -> str:
    """Both in one table, and whether chapters keep to what they may cost."""
    lines = ["| | whole dB | moving dB | kB | dynamic | flicker | where groups meet |", "|---|---|---|---|---|---|---|"]
    for name, values in (("sequence", sequence), ("chapters", chapters)):
        dynamic = sum(values["dynamic"]) / len(values["dynamic"])
        cells = [f"{values['psnr']:.2f}", f"{values['psnr_moving']:.2f}", f"{values['reel_bytes'] / 1e3:.0f}"]
        borders = "" if values["flicker_borders"] is None else f"{values['flicker_borders']:.2f}"
        lines.append(f"| {name} | {' | '.join(cells)} | {dynamic:.0f} | {values['flicker']:.2f} | {borders} |")
    gained = {name: chapters[name] - sequence[name] for name in GOALS}
    larger = chapters["reel_bytes"] / sequence["reel_bytes"] - 1
    kept = all(gained[name] >= least for name, least in GOALS.items()) and larger <= MORE_BYTES
    said = ", ".join(f"{name} {value:+.2f} dB" for name, value in gained.items())
    return "\n".join(
        [*lines, "", f"{said}, bytes {larger:+.0%}: {'within' if kept else 'beyond'} what chapters may cost"]
    )


if __name__ == "__main__":
    tyro.cli(main)
