"""Reconstruct single frames of a capture on their own: an upper limit for a dynamic reconstruction of them.

python benchmarks/oracle.py CAPTURE --width 320 --frames 0:60 --reel OUT
"""

import dataclasses
import time
from pathlib import Path
from typing import Annotated

import tyro

from bench.oracle import oracle
from bench.oracle_report import OracleReport
from record import RESULTS, machine, record
from splatreel.base.display import console
from splatreel.base.errors import UsageError
from splatreel.base.process import peak_memory_bytes
from splatreel.base.threads import use as use_threads
from splatreel.capture.opening import open_capture
from splatreel.cli.options import parse_frames, parse_names, parse_numbers, reel_folder
from splatreel.cli.reconstruct import Device, configure
from splatreel.config import Quality
from splatreel.config.settings import changed
from splatreel.evaluation.reel_capture import open_reel_capture


def main(
    capture: tyro.conf.Positional[Path],
    /,
    width: int | None = None,
    frames: str | None = None,
    at: str | None = None,
    every: int = 15,
    hold_out: str | None = None,
    quality: Quality = "standard",
    iterations: int | None = None,
    device: Device = "auto",
    threads: int | None = None,
    reel: Path | None = None,
    seed: int = 0,
    out: Path | None = None,
    name: str | None = None,
    record_: Annotated[bool, tyro.conf.arg(name="record")] = False,
    note: str = "",
) -> None:
    """Reconstruct frames independently, to measure the quality that geometry and cameras allow. The same command continues.

    Args:
        capture: Folder of the videos or images and their cameras.
        width: Width of the images, in pixels; by default that of the reel's cameras, else their own.
        frames: Frames A to B - 1 of the capture, as A:B; by default those that the reel shows, else all.
        at: Frames to reconstruct, as 0,14,28, counted from the first of --frames, or as the reel counts them.
        every: Distance of the frames to reconstruct, if --at is not given.
        hold_out: Names of the cameras to compare with, as NAME,NAME; by default those of the reel, else of the format.
        quality: Preset of settings; it decides how long training takes.
        iterations: Iterations of each frame; by default those of the quality for its first keyframe.
        device: Device that trains: gpu is any graphics card, cuda an NVIDIA card with gsplat; auto uses one if it can.
        threads: Number of threads; by default one per core.
        reel: Reel of the same frames, or the output folder of its run, to compare with.
        seed: Seed of all random numbers.
        out: OUT/oracle.json gets each frame when it is finished, OUT/oracle.md the tables.
        name: Name of the capture in the record, one word; by default that of its folder.
        record_: Append the record to those of this project, benchmarks/results.jsonl, instead of OUT/results.jsonl.
        note: Note in the record.
    """
    use_threads(threads)
    before, started = machine(), time.monotonic()
    held_out, chosen = parse_names(hold_out, "--hold-out"), parse_numbers(at, "--at")
    if every < 1:
        raise UsageError(f"--every {every} is out of range. Choose 1 or more.")
    config = configure(quality, None, None, seed)
    if iterations is not None:
        config = changed(config, {"keyframe.first_iterations": iterations})
    request = {"width": width, "frames": parse_frames(frames), "held_out": held_out}
    reel = reel and reel_folder(reel)
    if reel is None:
        source = open_capture(capture, **request)
        shown = list(range(source.frames))
    else:
        source, shown = open_reel_capture(reel, capture, **request)
    out = out or Path(f"out/oracle-{source.name}-{source.width}-{quality}")
    chosen = shown[::every] if chosen is None else chosen
    progress = console()
    try:
        result = oracle(source, out, config, chosen, reel=reel, device=device, progress=progress)
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
    record(f"oracle {name or source.name} {source.width}", values, note, RESULTS if record_ else out / "results.jsonl")
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
