"""The player of `splatreel demo`: it plays the sample reel at once, and the user's reel while it is being made."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path

from splatreel.base.errors import UsageError
from splatreel.base.progress import Estimate, Progress, Span
from splatreel.cli.browser import open_browser
from splatreel.cli.printing import say


class DemoPlayer:
    """Progress display of the demo that also reports to the demo's page, and says once what can be watched.

    Args:
        progress: Display of the progress.
        out: Output folder of the demo.
        port: Port to listen on; 0 takes any free one.

    Raises:
        UsageError: This machine lets no server listen.
    """

    def __init__(self, progress: Progress, out: Path, port: int = 0) -> None:
        from splatreel.cli.serve import run_report
        from splatreel.play.demo_page import NAME, SAMPLE, DemoPage
        from splatreel.play.served_files import RunFiles, ServedFiles
        from splatreel.play.server import Server

        self._progress = progress
        self._estimate = Estimate()
        self._own = RunFiles(out)
        self._page = DemoPage(self._own)
        pages = {NAME: self._page, **run_report(out / "reel", always=True)}
        self.server = Server(self._own, port=port, pages=pages, reels={"sample": ServedFiles(SAMPLE)})
        self.page = f"{self.server.url}{NAME}"
        self._name = ""
        self._told = self._own.shows

    def stage(self, name: str, total: int, span: Span | None = None) -> None:
        """Start a stage."""
        self._name = name
        self._estimate.stage(total, span)
        self._page.report(name)
        self._progress.stage(name, total, span)

    def update(self, done: int, **numbers: float) -> None:
        """Report finished steps."""
        self._estimate.done = done
        left = self._estimate.seconds_left()
        time_text = "" if left is None or left < 0.5 else f", {self._estimate.in_words(left)}"
        self._page.report(f"{self._name}: {100 * self._estimate.share:.0f} %{time_text}")
        self._progress.update(done, **numbers)
        if not self._told and self._own.shows:
            self._told = True
            self.note(f"Watch your own reel, first its keyframe, later moving: {self.server.url}")

    def note(self, text: str) -> None:
        """Show one line."""
        self._progress.note(text)

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
