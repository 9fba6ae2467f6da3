"""Changes of the pages for the site, and a check of the finished site.

Links out of docs/ lead to the repository, long names in tables break after / and :, the first page plays the sample reel, and the
page of the configuration lists all settings.
The guide for contributors, which lies at the top of the repository, is a page of the site.
"""

import posixpath
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

ROOT = Path(__file__).parent.parent
GUIDE = "CONTRIBUTING.md"
PLAY = Path(__file__).parent.parent / "src" / "splatreel" / "play"
PLAYER, SAMPLE = PLAY / "static", PLAY / "sample"
LIVE = "sample"
"""Folder of the site with the player and the sample reel. No page may have this name."""
CELL = re.compile(r"<td.*?</td>", re.DOTALL)
CODE = re.compile(r"<code>([^<]+)</code>")
LINK = re.compile(r"\]\((?![a-z]+:|#)([^)#\s]+)((?:#[^)]*)?)\)")
SETTINGS = "<!-- The site lists all settings here. -->"
IMAGE = re.compile(r"^!\[([^\]]*)\]\(images/reel\.webp\)$", re.MULTILINE)
REEL = f"""<splat-reel src="{LIVE}/reel/manifest.json" autoplay muted loop controls aria-label="The built-in scene"></splat-reel>
<script type="module" src="{LIVE}/player.js"></script>

*Drag to look around. `splatreel demo` makes this reel.*"""


def on_files(files: Any, *, config: Any) -> Any:
    """Add the guide for contributors to the pages."""
    from mkdocs.structure.files import File

    files.append(File.generated(config, GUIDE.lower(), content=(ROOT / GUIDE).read_text(encoding="utf-8")))
    return files


def on_page_markdown(markdown: str, *, page: Any, config: Any, files: Any) -> str:
    """Let links to files outside docs/ lead to the repository, play the sample in place of the first page's image, list settings."""
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
    return markdown.replace(SETTINGS, settings_tables()) if SETTINGS in markdown else markdown


def settings_tables() -> str:
    """Return a Markdown table of the settings of each section: default, meaning, and when they have an effect."""
    from splatreel.config import Config
    from splatreel.config.setting_values import shown
    from splatreel.config.settings import sections, settings

    usual, lines = Config(), list[str]()
    for section, purpose in sections().items():
        lines += [f"## {section or 'General'}", "", purpose, "", "| setting | default | meaning |", "|---|---|---|"]
        for setting in settings().values():
            if setting.section == section:
                needs = "".join(f" Has an effect only with `{need}`." for need in setting.needs)
                text = f"{setting.doc} Takes {setting.kind}.{needs}".replace("|", r"\|")
                lines.append(f"| `{setting.name}` | {shown(setting.of(usual))} | {text} |")
        lines.append("")
    return "\n".join(lines)


def on_page_content(html: str, **_: Any) -> str:
    """Let names of files in narrow columns of tables break after / and : only. Blocks of code do not break."""

    def with_breaks(match: re.Match[str]) -> str:
        return re.sub(r"(?<=\w[/:])(?=\w)", "<wbr>", match[0])

    return CELL.sub(lambda cell: CODE.sub(with_breaks, cell[0]), html)


def on_post_page(output: str, **_: Any) -> str:
    """Remove the mark by which the theme's script asks api.github.com for the stars of the repository."""
    return output.replace(' data-md-component="source"', "")


def on_post_build(config: Any) -> None:
    """Finish the site, and fail if it has faults.

    Raises:
        mkdocs.exceptions.PluginError: The folder of the player is a page already, or links lead nowhere.
    """
    if faults := finish_site(Path(config.site_dir), urlsplit(config.site_url).path):
        from mkdocs.exceptions import PluginError

        raise PluginError("\n".join(["The finished site has faults:", *faults]))


def finish_site(site: Path, root: str = "/") -> list[str]:
    """Copy the player with the sample reel, which are static files, into a site. Return its faults.

    Args:
        site: Folder of the site.
        root: Path of the site's address; links that start with it are links from the top of the site.
    """
    faults = []
    if SAMPLE.is_dir():
        if (site / LIVE).exists():
            faults.append(f"{LIVE}/ is already a page of the site: rename the page, or the folder of the player")
        else:
            shutil.copytree(PLAYER, site / LIVE)
            shutil.copytree(SAMPLE, site / LIVE / "reel")
    return faults + broken_links(site, root)


class _Page(HTMLParser):
    """The links and anchors of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: set[str] = set()
        self.anchors: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name in ("href", "src", "poster") and value and (tag, name) != ("base", "href"):
                self.links.add(value)
            elif name in ("id", "name") and value:
                self.anchors.add(value)


def broken_links(site: Path, root: str = "/") -> list[str]:
    """Return the links of a finished site that lead to no file or to no anchor, each with its page."""
    pages = {path: _Page(path.read_text(encoding="utf-8")) for path in sorted(site.rglob("*.html"))}
    broken = []
    for path, page in pages.items():
        for link in sorted(page.links):
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            place = unquote(parts.path)
            target = site / place.removeprefix(root) if place.startswith("/") else path.parent / place
            target = path if not place else (target / "index.html" if target.is_dir() else target)
            known = pages.get(Path(posixpath.normpath(target.as_posix())))
            missing = unquote(parts.fragment) if known and parts.fragment else ""
            if not target.is_file() or (known and missing and missing not in known.anchors):
                broken.append(f"{path.relative_to(site).as_posix()}: {link}")
    return broken
