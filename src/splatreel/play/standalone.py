"""A reel with its player as one HTML file, which plays wherever it lies: on a disk, in a mail, on any host."""

from __future__ import annotations

import re
from base64 import b64encode
from dataclasses import replace
from pathlib import Path

from splatreel.codec.container import unpack_file, write_atomically
from splatreel.codec.file_entry import FileEntry
from splatreel.codec.presentation import Asset
from splatreel.codec.reader import ReelReader
from splatreel.errors import ReelError
from splatreel.play.player_page import STATIC, with_metadata

LOADER = re.compile(r'<script type="module" data-early>.*?</script>', re.S)
PAGE = "<main data-splatreel-page>"
"""What stands in the player's own page."""
ELSEWHERE = ("player", "hevc", "draco")
"""How the names begin of scripts that are no files in the page: the player itself, what the paper's codec needs."""


def write_standalone(path: Path, location: str | Path, rendition: str | None = None) -> int:
    """Write the file atomically; returns its bytes. rendition: one of those the manifest names; None: the best.

    Raises `ReelError` for a reel that is damaged, or coded as in the paper: workers in a page do not find the decoders of others.
    """
    reel = ReelReader(location, rendition)
    manifest = reel.manifest
    if manifest.renditions:
        manifest = manifest.select_rendition(manifest.renditions[0])
    manifest = replace(manifest.without_pages(), live=False)
    page = (STATIC / "index.html").read_text(encoding="utf-8")
    parts = [f'<script type="application/json" id="splatreel-manifest">{_inert(manifest.to_json())}</script>']
    parts += [_file("reel", entry.uri, _checked(reel, entry)) for entry in [*manifest.files, *manifest.assets]]
    scripts = [script for script in sorted(STATIC.glob("*.js")) if not script.name.startswith(ELSEWHERE)]
    parts += [_file("player", script.name, script.read_bytes()) for script in scripts]
    player = (STATIC / "player.js").read_text(encoding="utf-8")
    parts.append(f'<script type="module">{_inert_code(player)}</script>')
    loader = LOADER.search(page)
    if loader is None or PAGE not in page:
        raise ReelError(f"{STATIC / 'index.html'}: has no loader, or not {PAGE}. Build the player again.")
    page = page.replace(loader[0], "\n".join(parts), 1).replace(PAGE, PAGE.replace(">", ' data-src="embedded:">'), 1)
    data = with_metadata(page, manifest.presentation).encode()
    write_atomically(path, data)
    return len(data)


def _checked(reel: ReelReader, entry: FileEntry | Asset) -> bytes:
    data = reel.read_file(entry)
    if isinstance(entry, FileEntry):
        means = unpack_file(data)[1].get("means")
        if means is not None and means.parameters.get("codec") != "lattice":
            raise ReelError(
                f"{reel.name}: {entry.uri} is coded as in the paper. Write a reel of the predictive codec: "
                "splatreel encode RUN --out REEL."
            )
    return data


def _file(kind: str, name: str, data: bytes) -> str:
    return f'<script type="text/plain" data-{kind}-file="{name}">{b64encode(data).decode()}</script>'


def _inert(text: str) -> str:
    """JSON that ends no element."""
    return text.replace("<", "\\u003c")


def _inert_code(text: str) -> str:
    """The same program, of whose strings none ends the element or begins a comment in it."""
    return re.sub("</(?=script)", r"<\\/", text, flags=re.IGNORECASE).replace("<!--", r"\x3c!--")
