"""The player's page with the metadata of a reel: its title, and tags for link previews (Open Graph, Twitter cards)."""

from __future__ import annotations

import shutil
from html import escape
from pathlib import Path

from splatreel.codec.presentation import Presentation

STATIC = Path(__file__).parent / "static"
"""The built web player."""
TITLE = "<title>Splatreel</title>"
"""Title element of the built page, which is replaced."""


def copy_player(folder: str | Path) -> None:
    """Copy the web player into a folder, for a page that any static web host serves. Files of an older player are replaced.

    The page loads `player.js` of the folder, which defines `<splat-reel>`.
    """
    shutil.copytree(STATIC, folder, dirs_exist_ok=True)


def with_metadata(page: str, presentation: Presentation, address: str | None = None) -> str:
    """Return the page with the title and tags of a reel.

    Args:
        page: HTML of the player's page.
        presentation: Metadata of the reel.
        address: URL of the folder that holds the page and `reel/`. Without it the tags name no image.
    """
    title = presentation.title or "Splatreel"
    tags = {
        "author": presentation.author,
        "description": presentation.description,
        "og:type": "website",
        "og:title": title,
    }
    tags["og:description"] = presentation.description
    if address and presentation.poster:
        tags |= {
            "og:url": address,
            "og:image": f"{address}reel/{presentation.poster.asset.uri}",
            "og:image:width": str(presentation.poster.width),
            "og:image:height": str(presentation.poster.height),
            "og:image:alt": title,
            "twitter:card": "summary_large_image",
        }
    lines = [f"<title>{escape(title)}</title>"]
    for name, value in tags.items():
        kind = "property" if name.startswith("og:") else "name"
        if value:
            lines.append(f'<meta {kind}="{name}" content="{escape(value)}" />')
    if address and presentation.poster:  # the browser requests it before the manifest arrives
        lines.append(
            f'<link rel="preload" as="image" href="reel/{presentation.poster.asset.uri}" fetchpriority="high" />'
        )
    return page.replace(TITLE, "\n    ".join(lines), 1)
