"""`splatreel demo`: film, reconstruct, evaluate and play the built-in scene."""

from __future__ import annotations

import dataclasses
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from splatreel.base.threads import use as use_threads
from splatreel.cli.demo_player import demo_player
from splatreel.cli.options import Set, check_effect, parse_set, with_set
from splatreel.cli.outputs import check_out
from splatreel.cli.printing import say, serving
from splatreel.cli.reconstruct import Device, configure, with_renditions
from splatreel.cli.serve import wait_for_viewers
from splatreel.config import Config, Quality

if TYPE_CHECKING:
    from splatreel.base.progress import Progress
    from splatreel.evaluation.report import Report
    from splatreel.run.pipeline import Result

WORDS = {
    "title": "A toy room",
    "author": "Splatreel",
    "description": "The built-in capture: a small scene, traced by Splatreel's own ray tracer, filmed by fourteen cameras.",
    "licence": "Apache-2.0",
}


def demo(
    out: Path,
    serve: bool = True,
    quality: Quality = "standard",
    device: Device = "auto",
    width: int = 256,
    height: int = 192,
    frames: int = 60,
    seed: int = 0,
    settings: Set = (),
    threads: int | None = None,
) -> None:
    """Reconstruct a small built-in scene, evaluate the decoded reel, and play it in the browser.

    A finished reel of the scene plays at once, and the user's own while it is being made.

    Args:
        out: Folder that gets OUT/capture, OUT/work, OUT/reel and OUT/report.json. After an interruption, the same command continues.
        serve: Serve the player from the start, and at a terminal until Ctrl-C. Without a terminal the demo just ends.
        quality: Preset of settings; it decides how long training takes.
        device: Device that trains: gpu is any graphics card, cuda an NVIDIA card with gsplat; auto uses one if it can.
        width: Width of the videos in pixels, even.
        height: Height of the videos in pixels, even.
        frames: Number of frames of the videos, at 30 frames a second.
        seed: Seed of all random numbers.
        settings: Any setting that `splatreel config` lists, such as group.lambda_arap=0; may be repeated.
        threads: Number of threads; by default one per core.
    """
    use_threads(threads)
    check_out("--out", out)
    config = with_renditions(with_set(demo_config(quality, seed), settings), ())
    check_effect(config, {name: f"--set {name}" for name in parse_set(settings)})
    from splatreel.base.display import console

    progress = console()
    with demo_player(progress, out, serve) as player:
        try:
            film = {"width": width, "height": height, "frames": frames, "seed": seed}
            result, report = reconstruct_demo(out, config, device, film, player or progress)
        finally:
            progress.close()
        say(report.to_markdown())
        say(f"Report: {out / 'report.json'}\nImages beside the cameras' own: {out / 'pictures'}\nReel: {result.reel}")
        if player is None or not sys.stdout.isatty():
            say(f"Play it with\n  {serving(result.reel)}")
        else:
            player.finish()
            wait_for_viewers(player.server, pages=["report.html"])


def reconstruct_demo(
    out: Path, config: Config, device: Device, film: dict[str, int], progress: Progress
) -> tuple[Result, Report]:
    """Make the built-in capture, reconstruct and evaluate it.

    Args:
        out: Output folder.
        config: Settings.
        device: Device that trains.
        film: Arguments of `make_capture`.
        progress: Display of the progress.
    """
    from splatreel.base import threads
    from splatreel.capture.builtin.synthetic import film_with_progress
    from splatreel.capture.opening import open_capture
    from splatreel.kernels.warmup import background_warmup

    with background_warmup(progress, threads.count()):
        from splatreel.evaluation.evaluate import evaluate, uncompressed_frames
        from splatreel.play.presentation_writer import PresentationWriter
        from splatreel.run import pipeline
        from splatreel.run.store import Store

        start = time.monotonic()
        folder = film_with_progress(out / "capture", progress, **film)
        filming = round(time.monotonic() - start, 3)
        capture = open_capture(folder)
        result = pipeline.reconstruct(
            capture, out, config, device=device, progress=progress, present=PresentationWriter(otherwise=WORDS)
        )
        known = Store(result.work).coverage()
        report = evaluate(
            result.reel,
            capture,
            out=out,
            undecoded=uncompressed_frames(result.work, result.reel),
            seconds={"capture": filming, **result.seconds},
            device=result.device,
            progress=progress,
            coverage=known.sentences() if known else (),
        )
        capture.close()
    return result, report


def demo_config(quality: Quality, seed: int) -> Config:
    """Return a preset without the trial of novel views: the cameras of the built-in scene are known to suffice."""
    return dataclasses.replace(configure(quality, None, None, seed), check_coverage=False)
