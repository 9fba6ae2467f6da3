"""Measure the speed of this machine: kernels, codecs, or a whole reconstruction; or bytes against quality of a run.

python benchmarks/measure.py kernels | codec [RUN CAPTURE] | reconstruct CAPTURE --out OUT
"""

import dataclasses
import json as json_format
import sys
from pathlib import Path
from typing import Annotated

from tyro.conf import OmitArgPrefixes, Positional, arg
from tyro.extras import SubcommandApp

from bench.microbenchmarks import bench_codec, bench_kernels
from bench.provenance import append, label
from bench.rate_chart import rate_chart
from bench.rate_distortion import Sweep, curves, rate_distortion_points, table
from bench.speed import bench_reconstruct
from splatreel.base.display import console
from splatreel.base.errors import MissingDependencyError, UsageError
from splatreel.base.threads import use as use_threads
from splatreel.cli.options import CaptureFolder, CaptureOptions, check_out, parse_frames
from splatreel.cli.printing import say
from splatreel.cli.reconstruct import Device, configure
from splatreel.config import Quality
from splatreel.evaluation.reel_capture import open_reel_capture
from splatreel.evaluation.report import write_text
from splatreel.run.device_choice import pick_gpu

app = SubcommandApp()


@app.command
def kernels(
    points: int = 20_000,
    width: int = 320,
    height: int = 240,
    repeats: int = 20,
    threads: int | None = None,
    json: bool = False,
) -> None:
    """Time rendering and training steps, and the gain by threads and motion layering.

    Args:
        points: Number of Gaussians in the image.
        width: Width of the image in pixels.
        height: Height of the image in pixels.
        repeats: Number of repeats; the median counts.
        threads: Number of threads; by default one per core.
        json: Print one JSON object per line.
    """
    use_threads(threads)
    show(bench_kernels(points, width, height, repeats), json)


@app.command
def codec(
    run: Annotated[Positional[Path | None], arg(metavar="[RUN]")] = None,
    capture: Annotated[Positional[Path | None], arg(metavar="[CAPTURE]")] = None,
    /,
    points: int = 10_000,
    frames: int = 35,
    repeats: int = 3,
    every: int = 4,
    width: int | None = None,
    span: str | None = None,
    out: Path | None = None,
    json: bool = False,
) -> None:
    """Time the encoding and decoding of a group; or, for a run, measure bytes and quality of each codec's settings.

    Args:
        run: Output folder of `reconstruct` or `demo`, to encode in many ways without training.
        capture: Folder of the capture that the run was made from.
        points: Number of dynamic points of the group that is timed.
        frames: Number of frames of that group.
        repeats: Number of repeats; the median counts.
        every: Distance of the frames of a run that are compared with the held-out cameras.
        width: Width of the capture's images, in pixels; by default that of the reel's cameras.
        span: Frames of the capture to compare with, as A:B; by default those of the run.
        out: Folder for codec.md, codec.svg and codec.jsonl, from which the same command continues.
        json: Print one JSON object per line.
    """
    if run is None:
        return show(bench_codec(points, frames, repeats), json)
    if out is not None:
        check_out("--out", out, run / "reel", run / "work")
    if capture is None or every < 1:
        raise UsageError("measure.py codec RUN needs the CAPTURE after it, and --every 1 or more.")
    source, shown = open_reel_capture(run / "reel", capture, width=width, frames=parse_frames(span))
    progress = console()
    record = None if out is None else out / "codec.jsonl"
    try:
        sweep = Sweep(run, source, shown[::every], progress, record)
        rows = rate_distortion_points(sweep)
        text = table(rows)
    finally:
        progress.close()
        source.close()
    if out is not None:
        write_text(out / "codec.md", text)
        try:
            write_text(out / "codec.svg", rate_chart(curves(rows), f"{run.name}: held-out cameras"))
        except MissingDependencyError as error:
            print(f"{out / 'codec.svg'} was not drawn. {error}", file=sys.stderr)
    say("\n".join(json_format.dumps(dataclasses.asdict(row)) for row in rows) if json else text)


@app.command
def reconstruct(
    capture: CaptureFolder,
    /,
    out: Path,
    images: OmitArgPrefixes[CaptureOptions] = CaptureOptions(),  # noqa: B008 - it is frozen
    quality: Quality = "standard",
    against: Quality | None = None,
    loop: int | None = None,
    repeats: int = 5,
    device: Device = "auto",
    seed: int = 0,
    threads: int | None = None,
    json: bool = False,
) -> None:
    """Time a reconstruction, and the gain by motion layering and threads. The same command continues.

    Args:
        capture: Folder of the videos or images and their cameras.
        out: OUT/QUALITY gets the reel; OUT/bench.jsonl gets a line for each measurement.
        images: Size, frames and cameras to train on.
        quality: Preset of settings; it decides how long training takes.
        against: Another quality to compare with. The quality paper may take hours.
        loop: Reconstruct once more with the frames repeated up to this number, to see whether memory grows.
        repeats: Number of repeats of timed iterations; the median counts.
        device: Device that trains: gpu is any graphics card, cuda an NVIDIA card with gsplat; auto uses one if it can.
        seed: Seed of all random numbers.
        threads: Number of threads; by default one per core.
        json: Print one JSON object per line.
    """
    use_threads(threads)
    check_out("--out", out, capture, below=False)
    request = images.source(capture)
    if repeats < 1 or against == quality:
        raise UsageError("measure.py reconstruct needs --repeats 1 or more, and an --against that is another quality.")
    configs = {name: configure(name, None, None, seed) for name in (quality, against) if name is not None}
    source = request()
    gpu, _ = pick_gpu(device)
    made, progress = label(source, "cpu" if gpu is None else gpu.kind), console()
    try:
        limits = {"loop": loop, "repeats": repeats}
        rows = bench_reconstruct(source, out, configs, device=device, progress=progress, **limits)
    finally:
        progress.close()
        source.close()
    append(out / "bench.jsonl", made, rows)
    show(rows, json)


def show(rows: list[dict[str, float | int | str]], json: bool) -> None:
    """Print measurements, one per line."""
    for row in rows:
        if json:
            say(json_format.dumps(row))
        else:
            rest = ", ".join(f"{name} {value:,}" for name, value in row.items() if name not in ("what", "ms"))
            time = f"{row['ms']:>10,.1f} ms" if "ms" in row else " " * 13
            say(f"{row['what']:<16} {time}   {rest}")


if __name__ == "__main__":
    app.cli()
