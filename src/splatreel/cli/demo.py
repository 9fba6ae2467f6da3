"""`splatreel demo`: reconstruct and evaluate the built-in scene. Its player shows the sample reel, then the user's own."""

from __future__ import annotations

import contextlib
import dataclasses
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from splatreel.base.display import console
from splatreel.base.errors import UsageError
from splatreel.base.progress import Estimate, PassedOn, Progress, Span, join_texts
from splatreel.base.threads import use as use_threads
from splatreel.cli.options import Set, check_effect, check_out, parse_set, with_set
from splatreel.cli.printing import say, serving
from splatreel.cli.reconstruct import Device, configure, with_renditions
from splatreel.cli.serve import open_browser, wait_for_viewers
from splatreel.config import Config, Quality

if TYPE_CHECKING:
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
    width: int | None = None,
    frames: int | None = None,
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
        width: Width in pixels; by default that of the videos, 256.
        frames: Number of frames that are read, at 30 frames a second; by default all 60.
        seed: Seed of all random numbers.
        settings: Any setting that `splatreel config` lists, such as group.lambda_arap=0; may be repeated.
        threads: Number of threads; by default one per core.
    """
    use_threads(threads)
    check_out("--out", out)
    config = with_renditions(with_set(demo_config(quality, seed), settings), ())
    check_effect(config, {name: f"--set {name}" for name in parse_set(settings)})

    with demo_player(progress := console(), out, serve) as player:
        with progress:
            request = {"width": width, "frames": None if frames is None else (0, frames)}
            result, report = reconstruct_demo(out, config, device, request, player or progress)
        say(report.to_markdown())
        say(f"Report: {out / 'report.json'}\nImages beside the cameras' own: {out / 'pictures'}\nReel: {result.reel}")
        if player is None or not sys.stdout.isatty():
            say(f"Play it with\n  {serving(result.reel)}")
        else:
            player.finish()
            wait_for_viewers(player.server, pages=["report.html"])


def reconstruct_demo(
    out: Path, config: Config, device: Device, request: dict[str, Any], progress: Progress
) -> tuple[Result, Report]:
    """Copy the built-in capture, reconstruct and evaluate it.

    Args:
        out: Output folder.
        config: Settings.
        device: Device that trains.
        request: Arguments of `open_capture`.
        progress: Display of the progress.
    """
    from splatreel.base import threads
    from splatreel.capture.builtin_film import copy_film
    from splatreel.capture.opening import open_capture
    from splatreel.kernels.warmup import background_warmup

    with background_warmup(progress, threads.count()):
        from splatreel.evaluation.evaluate import evaluate, uncompressed_frames
        from splatreel.play.presentation_writer import PresentationWriter
        from splatreel.run import pipeline
        from splatreel.run.store import Store

        start = time.monotonic()
        capture = open_capture(copy_film(out / "capture"), **request)
        copying = round(time.monotonic() - start, 3)
        result = pipeline.reconstruct(
            capture, out, config, device=device, progress=progress, present=PresentationWriter(otherwise=WORDS)
        )
        known = Store(result.work).coverage()
        report = evaluate(
            result.reel,
            capture,
            out=out,
            undecoded=uncompressed_frames(result.work, result.reel),
            seconds={"capture": copying, **result.seconds},
            device=result.device,
            progress=progress,
            coverage=known.sentences() if known else (),
        )
        capture.close()
    return result, report


def demo_config(quality: Quality, seed: int) -> Config:
    """Return a preset without the trial of novel views: the cameras of the built-in scene are known to suffice."""
    return dataclasses.replace(configure(quality, None, None, seed), check_coverage=False)


class DemoPlayer(PassedOn):
    """Progress display of the demo that also reports to the demo's page, and says once what can be watched.

    Args:
        progress: Display of the progress.
        out: Output folder of the demo.

    Raises:
        UsageError: This machine lets no server listen.
    """

    def __init__(self, progress: Progress, out: Path) -> None:
        from splatreel.cli.serve import run_report
        from splatreel.play.demo_page import NAME, SAMPLE, DemoPage
        from splatreel.play.served_files import RunFiles, ServedFiles
        from splatreel.play.server import Server

        super().__init__(progress)
        self._estimate = Estimate()
        self._own = RunFiles(out)
        self._page = DemoPage(self._own)
        pages = {NAME: self._page, **run_report(out / "reel", always=True)}
        self.server = Server(self._own, pages=pages, reels={"sample": ServedFiles(SAMPLE)})
        self.page = f"{self.server.url}{NAME}"
        self._name = ""
        self._told = self._own.shows

    def stage(self, name: str, total: int, span: Span | None = None) -> None:
        """Start a stage."""
        self._name = name
        self._estimate.stage(total, span)
        self._page.report(name)
        super().stage(name, total, span)

    def update(self, done: int, **numbers: float) -> None:
        """Report finished steps."""
        self._estimate.done = done
        share, left = f"{100 * self._estimate.share:.0f} %", self._estimate.left_in_words()
        self._page.report(f"{self._name}: {join_texts(share, left)}")
        super().update(done, **numbers)
        if not self._told and self._own.shows:
            self._told = True
            self.note(f"Watch your own reel, first its keyframe, later moving: {self.server.url}")

    def finish(self) -> None:
        """Say on the page that the user's reel is finished."""
        self._page.report("finished")


@contextlib.contextmanager
def demo_player(progress: Progress, out: Path, serve: bool) -> Iterator[DemoPlayer | None]:
    """Serve the demo's page in the block, and open it in a browser at a terminal. Without a terminal nobody is waited for.

    Args:
        progress: Display of the progress.
        out: Output folder of the demo.
        serve: Whether to serve at all.

    Yields:
        The progress display to use; None if nothing is served.
    """
    from splatreel.play.demo_page import has_sample

    if not serve:
        yield None
        return
    try:
        player = DemoPlayer(progress, out)
    except UsageError as error:
        progress.note(f"The reel is made without a player. {error}")
        yield None
        return
    with player.server:
        if has_sample():
            say(f"A finished reel of this scene plays at {player.page}")
            say("Your own reel is being made now. The same page shows it as soon as its first keyframe trains.")
        else:
            say(f"Your own reel is being made now. It plays at {player.page} as soon as its first keyframe trains.")
        say("Ctrl-C loses nothing: the same command continues.", flush=True)
        if sys.stdout.isatty():
            open_browser(player.page)
        yield player
