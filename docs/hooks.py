"""Changes of the pages for the site.

Links out of docs/ lead to the repository, long names in tables break after / and :, and the first page plays the sample reel.
The guide for contributors, which lies at the top of the repository, is a page of the site.
"""

import posixpath
import re
import shutil
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent
GUIDE = "CONTRIBUTING.md"
PLAY = Path(__file__).parent.parent / "src" / "splatreel" / "play"
PLAYER, SAMPLE = PLAY / "static", PLAY / "sample"
CELL = re.compile(r"<td.*?</td>", re.DOTALL)
CODE = re.compile(r"<code>([^<]+)</code>")
LINK = re.compile(r"\]\((?![a-z]+:|#)([^)#\s]+)((?:#[^)]*)?)\)")
IMAGE = re.compile(r"^!\[([^\]]*)\]\(images/demo\.jpg\)$", re.MULTILINE)
REEL = """<splat-reel src="sample/manifest.json" autoplay muted loop controls aria-label="The built-in scene"></splat-reel>
<script type="module" src="player/player.js"></script>

*Drag to look around. This reel is what `make demo` makes.*"""


def on_files(files: Any, *, config: Any) -> Any:
    """Add the guide for contributors to the pages."""
    from mkdocs.structure.files import File

    files.append(File.generated(config, GUIDE.lower(), content=(ROOT / GUIDE).read_text(encoding="utf-8")))
    return files


def on_page_markdown(markdown: str, *, page: Any, config: Any, files: Any) -> str:
    """Let links to files outside docs/ lead to the repository, and play the sample instead of the first page's image."""
    here = posixpath.dirname(posixpath.join("docs", page.file.src_uri))
    folder = "" if page.file.src_uri == GUIDE.lower() else here

    def replace(match: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(folder, match[1]))
        if target == GUIDE:
            target = posixpath.join("docs", GUIDE.lower())
        if target.startswith("docs/"):
            return f"]({posixpath.relpath(target, here)}{match[2]})"
        return f"]({config.repo_url}/blob/main/{target}{match[2]})"

    markdown = LINK.sub(replace, markdown)
    if page.file.src_uri == "index.md" and SAMPLE.is_dir():
        markdown = IMAGE.sub(lambda _: REEL, markdown)
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
