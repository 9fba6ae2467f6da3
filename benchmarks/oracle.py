"""Reconstruct single frames of a capture on their own: an upper limit for a dynamic reconstruction of them.

python benchmarks/oracle.py CAPTURE --width 320 --frames 0:60 --reel OUT
"""

import dataclasses
import time
from pathlib import Path
from typing import Annotated

import tyro

from record import RESULTS, machine, record
from splatreel.base.display import console
from splatreel.base.process import peak_memory_bytes
from splatreel.capture.opening import open_capture
from splatreel.cli.options import parse_frames, parse_names, parse_numbers, reel_folder
from splatreel.config import Quality, preset
from splatreel.evaluation.bench.oracle import oracle
from splatreel.evaluation.bench.oracle_report import OracleReport
from splatreel.evaluation.reel_capture import open_reel_capture


def main(
    capture: tyro.conf.Positional[Path],
    /,
    width: int,
    frames: str | None = None,
    at: str | None = None,
    every: int = 15,
    hold_out: str | None = None,
    quality: Quality = "standard",
    reel: Path | None = None,
    seed: int = 0,
    out: Path | None = None,
    name: str | None = None,
    record_: Annotated[bool, tyro.conf.arg(name="record")] = False,
    note: str = "",
) -> None:
    """Reconstruct frames on their own, and evaluate on the held-out cameras. Other options are those of `splatreel bench oracle`.

    Args:
        name: Name of the capture in the record, one word; by default that of its folder.
        record_: Append the record to those of this project, benchmarks/results.jsonl, instead of OUT/results.jsonl.
        note: Note in the record.
    """
    before, started = machine(), time.monotonic()
    held_out, chosen = parse_names(hold_out, "--hold-out"), parse_numbers(at, "--at")
    request = {"width": width, "frames": parse_frames(frames), "held_out": held_out}
    reel = reel and reel_folder(reel)
    if reel is None:
        source = open_capture(capture, **request)
        shown = list(range(source.frames))
    else:
        source, shown = open_reel_capture(reel, capture, **request)
    out = out or Path(f"out/oracle-{source.name}-{width}-{quality}")
    config = dataclasses.replace(preset(quality), seed=seed)
    chosen = shown[::every] if chosen is None else chosen
    progress = console()
    try:
        result = oracle(source, out, config, chosen, reel=reel, progress=progress)
    finally:
        progress.close()
        source.close()
    shape = {
        "width": source.width,
        "height": source.height,
        "first_frame": source.first_frame,
        "machine_before": before,
    }
    wall = {"seconds_wall": round(time.monotonic() - started, 1)}
    values = summary(result, config.keyframe.sh_degree) | {"quality": quality, "seed": seed} | shape | wall
    record(f"oracle {name or source.name} {width}", values, note, RESULTS if record_ else out / "results.jsonl")
    print(result.to_markdown())


def summary(result: OracleReport, sh_degree: int) -> dict:
    """Return means over the frames, and sums of bytes and seconds. The PSNR is that after encoding."""
    decoded, raw = result.decoded(), result.mean()
    size, points = (sum(getattr(frame, name) for frame in result.frames) for name in ("bytes", "points"))
    numbers = 3 + 4 + 3 + 1 + 3 * (sh_degree + 1) ** 2
    values = dataclasses.asdict(decoded) | {
        "psnr_undecoded": raw.whole.psnr,
        "psnr_moving_undecoded": raw.moving.psnr if raw.moving else None,
        "reel_bytes": size,
        "share_of_float32": round(size / (4 * numbers * points), 4),
        "points": points / len(result.frames),
        "seconds_total": round(sum(frame.seconds for frame in result.frames), 1),
        "peak_memory_bytes": peak_memory_bytes(),
        "device": result.frames[0].device,
        "frames": len(result.frames),
        "at": [frame.frame for frame in result.frames],
    }
    return values | ({"distance": result.distance()} if result.reel else {})


if __name__ == "__main__":
    tyro.cli(main)
