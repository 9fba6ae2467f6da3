"""Export of a reel and its player as one HTML file, which plays from a disk, a mail or any host."""

from __future__ import annotations

import re
from base64 import b64encode
from dataclasses import replace
from pathlib import Path

from splatreel.base.atomic import write_bytes
from splatreel.base.errors import ReelError
from splatreel.codec.container import unpack_file
from splatreel.codec.manifest import FileEntry
from splatreel.codec.presentation import Asset
from splatreel.codec.reader import ReelReader
from splatreel.play.player_page import STATIC, with_metadata

LOADER = re.compile(r'<script type="module" data-early>.*?</script>', re.S)
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
    loader = LOADER.search(page)
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
