"""The report page of a run as a server shows it: made anew when the run has changed."""

from __future__ import annotations

import base64
import hashlib
import threading
from pathlib import Path

from splatreel.recon.run.job_log import LOGS

SCRIPT = """
setInterval(async () => {
  const answer = await fetch(location.href, { cache: "no-cache" }).catch(() => null);
  if (!answer?.ok) return;
  const fresh = new DOMParser().parseFromString(await answer.text(), "text/html");
  for (const part of fresh.querySelectorAll("main > *")) {
    const old = document.getElementById(part.id);
    if (!old) return location.reload();
    if (part.id !== "player" && old.outerHTML !== part.outerHTML) old.replaceWith(part);
  }
}, 10000);
"""
"""Every ten seconds, replaces the parts of the page that changed. The player keeps playing."""


class ServedReport:
    """Report page that is made anew when a file of the run has changed. Thread-safe.

    Args:
        out: Output folder of the run, with report.json and pictures.
        reel: Folder of the reel.

    Attributes:
        policy: Content-Security-Policy of the page.
    """

    def __init__(self, out: Path, reel: Path) -> None:
        self._out, self._reel = out, reel
        self._lock = threading.Lock()
        self._seen: list[tuple[str, int, int]] | None = None
        self._text = ""
        digest = base64.b64encode(hashlib.sha256(SCRIPT.encode()).digest()).decode()
        self.policy = (
            f"default-src 'none'; script-src 'sha256-{digest}'; style-src 'unsafe-inline'; img-src data:; "
            "frame-src 'self'; connect-src 'self'; base-uri 'none'; form-action 'none'"
        )

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
                self._text, self._seen = page.replace("</body>", f"<script>{SCRIPT}</script>\n</body>"), seen
            return self._text

    def _state(self) -> list[tuple[str, int, int]]:
        """Return path, time and size of the files that the page is made of."""
        files = [self._out / "report.json", self._reel / "manifest.json", *self._out.glob("pictures/*/*.png")]
        files += sorted((self._out / "work" / LOGS).glob("history*.jsonl"))
        found = [(str(path), path.stat()) for path in files if path.is_file()]
        return [(path, status.st_mtime_ns, status.st_size) for path, status in found]
