"""Page of the demo: it plays the sample reel, and shows how far the user's own reel is and where it plays."""

from __future__ import annotations

import base64
import hashlib
from html import escape
from pathlib import Path

from splatreel.base.errors import ReelError
from splatreel.play.served_files import RunFiles

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


SAMPLE = Path(__file__).parent / "sample"
"""Folder of the sample reel in the package."""


def has_sample() -> bool:
    """Return whether the package contains the sample reel."""
    return (SAMPLE / "manifest.json").is_file()


def sample_reel() -> Path:
    """Return the folder of the sample reel.

    Raises:
        ReelError: The package does not contain it.
    """
    if not has_sample():
        raise ReelError(
            f"{SAMPLE}: this installation has no sample reel. `splatreel demo --out OUT` makes such a reel."
        )
    return SAMPLE


NAME = "demo.html"
OWN, SAMPLE_ADDRESS = "./", "./?src=sample/manifest.json&muted=1"
"""Addresses of the player with the user's reel and with the sample, relative to the page."""
SECONDS = 2.0
"""Seconds between two updates of the text."""
_STYLE = """
:root { color-scheme: light dark; }
html, body, main { height: 100%; margin: 0; }
main { display: flex; flex-direction: column; font: 16px/1.4 system-ui, sans-serif; }
header { padding: 8px 16px; }
h1 { display: inline; margin: 0 12px 0 0; font-size: 1rem; }
p { display: inline; margin: 0 12px 0 0; }
iframe { flex: 1; width: 100%; border: 0; }
"""


class DemoPage:
    """Page of the demo. Thread-safe.

    Args:
        own: Files of the user's run.

    Attributes:
        policy: Content-Security-Policy of the page.
    """

    policy = refreshed_policy(SECONDS)

    def __init__(self, own: RunFiles) -> None:
        self._own = own
        self._state = "starting"

    def report(self, state: str) -> None:
        """Set the text about the user's reel, such as the stage of its reconstruction."""
        self._state = state

    def read(self) -> str:
        """Return the page as HTML."""
        shown, known, own = self._own.shows, "", "Your own reel is being made"
        first = OWN if shown else ""
        if has_sample():
            first = SAMPLE_ADDRESS
            known = f'<a href="{escape(first)}" target="player">The sample: a finished reel of this scene</a>'
        if shown:
            own = f'<a href="{OWN}" target="player">Watch your own reel</a>'
        source = f'src="{escape(first)}" ' if first else ""
        page = f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>Splatreel demo</title>
<link rel="icon" href="data:,">
<style>{_STYLE}</style>
</head>
<body>
<main>
<header id="state"><h1>Splatreel demo</h1> <p>{known}</p> <p>{own} <small>({escape(self._state)})</small></p></header>
<iframe id="player" name="player" {source}title="Player" allow="fullscreen; autoplay; xr-spatial-tracking"></iframe>
</main>
</body>
</html>
"""
        return refreshed(page, SECONDS)
