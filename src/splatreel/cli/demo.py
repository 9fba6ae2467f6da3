"""`splatreel demo`: film, reconstruct, evaluate and play the built-in scene."""

from __future__ import annotations

import dataclasses
import sys
import time
from pathlib import Path

from splatreel.cli.options import Set, with_set
from splatreel.cli.printing import say, serving
from splatreel.cli.reconstruct import Device, configure, with_renditions
from splatreel.config import Config, Quality
from splatreel.threads import use as use_threads

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
    """Film a small scene, reconstruct it, evaluate the decoded reel, and play it in the browser.

    Args:
        out: Folder that gets OUT/capture, OUT/work, OUT/reel and OUT/report.json. After an interruption, the same command continues.
        serve: Serve the player at the end, until Ctrl-C. Without a terminal the demo just ends.
        quality: Preset of settings; it decides how long training takes.
        device: Device that trains; auto uses a CUDA GPU if there is one.
        width: Width of the videos in pixels, even.
        height: Height of the videos in pixels, even.
        frames: Number of frames of the videos, at 30 frames a second.
        seed: Seed of all random numbers.
        settings: Any setting that `splatreel config` lists, such as group.lambda_arap=0; may be repeated.
        threads: Number of threads; by default one per core.
    """
    use_threads(threads)
    config = with_renditions(with_set(demo_config(quality, seed), settings), ())
    from splatreel.capture.builtin.synthetic import make_capture
    from splatreel.capture.opening import open_capture
    from splatreel.evaluation.evaluate import evaluate
    from splatreel.evaluation.uncompressed import uncompressed_frames
    from splatreel.kernels.warmup import background_warmup
    from splatreel.play.presentation_writer import PresentationWriter
    from splatreel.progress import console
    from splatreel.recon import pipeline
    from splatreel.recon.run.store import Store

    progress = console()
    try:
        with background_warmup(progress):
            start = time.monotonic()
            progress.stage("filming the built-in scene", 100)
            folder = make_capture(
                out / "capture",
                width=width,
                height=height,
                frames=frames,
                fps=30,
                seed=seed,
                progress=lambda share: progress.update(round(100 * share)),
            )
            progress.update(100)
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
    finally:
        progress.close()
    capture.close()
    say(report.to_markdown())
    say(f"Report: {out / 'report.json'}\nImages beside the cameras' own: {out / 'pictures'}\nReel: {result.reel}")
    if serve and sys.stdout.isatty():
        from splatreel.cli.serve import serve as serve_reel

        serve_reel(str(result.reel), port=0)
    else:
        say(f"Play it with\n  {serving(result.reel)}")


def demo_config(quality: Quality, seed: int) -> Config:
    """Return a preset without the trial of novel views: the cameras of the built-in scene are known to suffice."""
    return dataclasses.replace(configure(quality, None, None, seed), check_coverage=False)
