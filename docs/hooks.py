"""Changes of the pages for the site.

Links out of docs/ lead to the repository, long names in tables break after / and :, and the first page plays the sample reel.
"""

import posixpath
import re
import shutil
from pathlib import Path
from typing import Any

PLAY = Path(__file__).parent.parent / "src" / "splatreel" / "play"
PLAYER, SAMPLE = PLAY / "static", PLAY / "sample"
CELL = re.compile(r"<td.*?</td>", re.DOTALL)
CODE = re.compile(r"<code>([^<]+)</code>")
LINK = re.compile(r"\]\((?![a-z]+:|#)([^)#\s]+)((?:#[^)]*)?)\)")
PICTURE = re.compile(r"^!\[([^\]]*)\]\(images/demo\.jpg\)$", re.MULTILINE)
REEL = """<splat-reel src="sample/manifest.json" autoplay muted loop controls aria-label="The built-in scene"></splat-reel>
<script type="module" src="player/player.js"></script>

*Drag to look around. This reel is what `make demo` makes.*"""


def on_page_markdown(markdown: str, *, page: Any, config: Any, files: Any) -> str:
    """Let links to files outside docs/ lead to the repository, and play the sample instead of the first page's picture."""
    folder = posixpath.dirname(posixpath.join("docs", page.file.src_uri))

    def replace(match: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(folder, match[1]))
        if target.startswith("docs/"):
            return match[0]
        return f"]({config.repo_url}/blob/main/{target}{match[2]})"

    markdown = LINK.sub(replace, markdown)
    if page.file.src_uri == "index.md" and SAMPLE.is_dir():
        markdown = PICTURE.sub(lambda _: REEL, markdown)
    return markdown


def on_page_content(html: str, **_: Any) -> str:
    """Let names of files in narrow columns of tables break after / and : only. Blocks of code do not break."""

    def with_breaks(match: re.Match[str]) -> str:
        return re.sub(r"(?<=\w[/:])(?=\w)", "<wbr>", match[0])

    return CELL.sub(lambda cell: CODE.sub(with_breaks, cell[0]), html)


def on_post_build(config: Any) -> None:
    """Copy the player and the sample reel, which are static files, into the site."""
    if SAMPLE.is_dir():
        site = Path(config.site_dir)
        shutil.copytree(PLAYER, site / "player", dirs_exist_ok=True)
        shutil.copytree(SAMPLE, site / "sample", dirs_exist_ok=True)
