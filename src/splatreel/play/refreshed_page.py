"""Pages that keep themselves up to date: a script fetches the page again and replaces the parts that changed."""

from __future__ import annotations

import base64
import hashlib

_SCRIPT = """
setInterval(async () => {
  const answer = await fetch(location.href, { cache: "no-cache" }).catch(() => null);
  if (!answer?.ok) return;
  const fresh = new DOMParser().parseFromString(await answer.text(), "text/html");
  for (const part of fresh.querySelectorAll("main > *")) {
    const old = document.getElementById(part.id);
    if (!old) return location.reload();
    if (part.id !== "player" && old.outerHTML !== part.outerHTML) old.replaceWith(part);
  }
}, MILLISECONDS);
"""


def refreshed(page: str, seconds: float) -> str:
    """Return a page that fetches itself again every few seconds.

    Each part of its `main` has an id. The part `player` is never replaced, so that it keeps playing.
    """
    return page.replace("</body>", f"<script>{_script(seconds)}</script>\n</body>")


def refreshed_policy(seconds: float) -> str:
    """Return the Content-Security-Policy of a page that `refreshed` returned."""
    digest = base64.b64encode(hashlib.sha256(_script(seconds).encode()).digest()).decode()
    return (
        f"default-src 'none'; script-src 'sha256-{digest}'; style-src 'unsafe-inline'; img-src data:; "
        "frame-src 'self'; connect-src 'self'; base-uri 'none'; form-action 'none'"
    )


def _script(seconds: float) -> str:
    return _SCRIPT.replace("MILLISECONDS", str(round(1000 * seconds)))
