"""Writes the report page while a run makes its reel."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from splatreel.base.errors import SplatreelError
from splatreel.base.progress import Progress
from splatreel.codec.writer import ReelWriter
from splatreel.evaluation.page.report_page import Player, write_report_page
from splatreel.run.output.group_writer import PresentationHook

LEAST_SECONDS = 30.0
"""Smallest time between two pages of a run."""
LARGEST_SHARE = 0.02
"""Largest share of a run's time that its pages take."""


class ReportWriter:
    """Hook of a run that writes OUT/report.html after a group, unless the last page is fresh enough.

    Args:
        out: Output folder of the run.
        present: Hook to call first.
        progress: Display for a page that cannot be written.
        clock: Seconds since any moment.
    """

    def __init__(
        self, out: Path, present: PresentationHook, progress: Progress, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._out = out
        self._present = present
        self._progress = progress
        self._clock = clock
        self._next = 0.0
        self._failed = False

    def __call__(self, writer: ReelWriter, group: int | None) -> None:
        """Write what changed of the presentation, then the page."""
        self._present(writer, group)
        if group is not None and self._clock() >= self._next:
            self._write("none")

    def finish(self) -> None:
        """Write the page of the finished reel, with its player."""
        if (self._out / "reel" / "manifest.json").is_file():
            self._write("embedded")

    def _write(self, player: Player) -> None:
        """Write the page. A run does not fail because of its page."""
        begun = self._clock()
        try:
            write_report_page(self._out, self._out / "reel", player)
        except (SplatreelError, OSError) as error:
            if not self._failed:
                self._progress.note(f"{self._out / 'report.html'} cannot be written ({error}).")
            self._failed = True
        now = self._clock()
        self._next = now + max(LEAST_SECONDS, (now - begun) / LARGEST_SHARE)
