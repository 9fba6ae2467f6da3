"""The player's page with a reel's metadata: its title, and tags for previews of links (Open Graph, Twitter cards)."""

from __future__ import annotations

from html import escape
from pathlib import Path

from splatreel.codec.presentation import Presentation

STATIC = Path(__file__).parent / "static"
"""The built web player."""
TITLE = "<title>Splatreel</title>"
"""What stands in the player's own page."""


def with_metadata(page: str, said: Presentation, address: str | None = None) -> str:
    """The page with title and tags. address: of the folder that holds the page and `reel/`; without it no picture is named."""
    title = said.title or "Splatreel"
    tags = {"author": said.author, "description": said.description, "og:type": "website", "og:title": title}
    tags["og:description"] = said.description
    if address and said.poster:
        tags |= {
            "og:url": address,
            "og:image": f"{address}reel/{said.poster.asset.uri}",
            "og:image:width": str(said.poster.width),
            "og:image:height": str(said.poster.height),
            "og:image:alt": title,
            "twitter:card": "summary_large_image",
        }
    lines = [f"<title>{escape(title)}</title>"]
    for name, value in tags.items():
        kind = "property" if name.startswith("og:") else "name"
        if value:
            lines.append(f'<meta {kind}="{name}" content="{escape(value)}" />')
    if address and said.poster:  # on its way before the page knows the manifest
        lines.append(f'<link rel="preload" as="image" href="reel/{said.poster.asset.uri}" fetchpriority="high" />')
    return page.replace(TITLE, "\n    ".join(lines), 1)
