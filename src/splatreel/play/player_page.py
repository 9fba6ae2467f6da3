"""Page of the player with the metadata of a reel (title, link previews), and the same page with the reel embedded in one HTML file."""

from __future__ import annotations

import re
import shutil
from base64 import b64encode
from dataclasses import replace
from html import escape
from pathlib import Path

from splatreel.base.atomic import write_bytes
from splatreel.base.errors import ReelError
from splatreel.codec.container import unpack_file
from splatreel.codec.manifest import FileEntry
from splatreel.codec.presentation import Asset, Presentation
from splatreel.codec.reader import ReelReader

STATIC = Path(__file__).parent / "static"
"""The built web player."""
_TITLE = "<title>Splatreel</title>"
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
    return page.replace(_TITLE, "\n    ".join(lines), 1)


_LOADER = re.compile(r'<script type="module" data-early>.*?</script>', re.S)
PAGE = "<main data-splatreel-page>"
"""Main element of the built page."""
EXCLUDED = ("player", "paper", "hevc", "draco", "self-test")
"""Name prefixes of scripts that are not embedded as files: the player itself, the paper's codec, and the self-test."""


def write_standalone(path: Path, location: str | Path, rendition: str | None = None) -> int:
    """Write the file atomically.

    Args:
        path: File to write.
        location: Directory or URL of the reel.
        rendition: One of those that the manifest names; None for the best.

    Returns:
        The number of bytes.

    Raises:
        ReelError: The reel is damaged, or uses the paper's codec, whose decoders cannot be embedded.
    """
    data = standalone_page(location, rendition).encode()
    write_bytes(path, data)
    return len(data)


def standalone_page(location: str | Path, rendition: str | None = None) -> str:
    """Return the content of the file. Arguments and errors are those of `write_standalone`."""
    reel = ReelReader(location, rendition)
    manifest = reel.manifest
    if manifest.renditions:
        manifest = manifest.select_rendition(manifest.renditions[0])
    manifest = replace(manifest.without_pages(), live=False)
    page = (STATIC / "index.html").read_text(encoding="utf-8")
    parts = [f'<script type="application/json" id="splatreel-manifest">{_escape_json(manifest.to_json())}</script>']
    parts += [_file("reel", entry.uri, _checked(reel, entry)) for entry in [*manifest.files, *manifest.assets]]
    scripts = [script for script in sorted(STATIC.glob("*.js")) if not script.name.startswith(EXCLUDED)]
    parts += [_file("player", script.name, script.read_bytes()) for script in scripts]
    player = (STATIC / "player.js").read_text(encoding="utf-8")
    parts.append(f'<script type="module">{_escape_script(player)}</script>')
    loader = _LOADER.search(page)
    if loader is None or PAGE not in page:
        raise ReelError(f"{STATIC / 'index.html'}: has no loader or no {PAGE}. Build the player again.")
    page = page.replace(loader[0], "\n".join(parts), 1).replace(PAGE, PAGE.replace(">", ' data-src="embedded:">'), 1)
    return with_metadata(page, manifest.presentation)


def _checked(reel: ReelReader, entry: FileEntry | Asset) -> bytes:
    data = reel.read_file(entry)
    if isinstance(entry, FileEntry):
        means = unpack_file(data)[1].get("means")
        if means is not None and means.parameters.get("codec") != "lattice":
            raise ReelError(
                f"{reel.name}: {entry.uri} uses the paper's codec. Encode the reel with the predictive codec: "
                "splatreel encode RUN --out REEL."
            )
    return data


def _file(kind: str, name: str, data: bytes) -> str:
    return f'<script type="text/plain" data-{kind}-file="{name}">{b64encode(data).decode()}</script>'


def _escape_json(text: str) -> str:
    """Escape JSON so that it cannot end the script element."""
    return text.replace("<", "\\u003c")


def _escape_script(text: str) -> str:
    """Escape a script so that none of its strings ends the script element or begins a comment."""
    return re.sub("</(?=script)", r"<\\/", text, flags=re.IGNORECASE).replace("<!--", r"\x3c!--")
