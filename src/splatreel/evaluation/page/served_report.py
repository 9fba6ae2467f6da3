"""The report page of a run as a server shows it: made anew when the run has changed."""

from __future__ import annotations

import threading
from pathlib import Path

from splatreel.play.refreshed_page import refreshed, refreshed_policy
from splatreel.run.run_logs import LOGS

SECONDS = 10.0
"""Seconds between two updates of the page. The player keeps playing."""


class ServedReport:
    """Report page that is made anew when a file of the run has changed. Thread-safe.

    Args:
        out: Output folder of the run, with report.json and images.
        reel: Folder of the reel.

    Attributes:
        policy: Content-Security-Policy of the page.
    """

    def __init__(self, out: Path, reel: Path) -> None:
        self._out = out
        self._reel = reel
        self._lock = threading.Lock()
        self._seen: list[tuple[str, int, int]] | None = None
        self._text = ""
        self.policy = refreshed_policy(SECONDS)

    def read(self) -> str:
        """Return the page as HTML.

        Raises:
            ReelError: There is no reel.
        """
        # Not at the top: it imports torch, and `serve` starts without.
        from splatreel.evaluation.page.report_page import report_page
        from splatreel.evaluation.page.run_facts import RunFacts

        with self._lock:
            seen = self._state()
            if seen != self._seen:
                page = report_page(RunFacts.read(self._out, self._reel), "beside")
                self._text = refreshed(page, SECONDS)
                self._seen = seen
            return self._text

    def _state(self) -> list[tuple[str, int, int]]:
        """Return path, time and size of the files that the page is made of."""
        files = [self._out / "report.json", self._reel / "manifest.json", *self._out.glob("pictures/*/*.png")]
        files += sorted((self._out / "work" / LOGS).glob("history*.jsonl"))
        found = [(str(path), path.stat()) for path in files if path.is_file()]
        return [(path, status.st_mtime_ns, status.st_size) for path, status in found]
