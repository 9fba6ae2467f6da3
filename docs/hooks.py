"""Changes of the pages for the site: links out of docs/ lead to the repository, and long names break after / and :."""

import posixpath
import re
from typing import Any

CODE = re.compile(r"<code>([^<]+)</code>")
LINK = re.compile(r"\]\((?![a-z]+:|#)([^)#\s]+)((?:#[^)]*)?)\)")


def on_page_markdown(markdown: str, *, page: Any, config: Any, files: Any) -> str:
    """Let links to files outside docs/ lead to the repository."""
    folder = posixpath.dirname(posixpath.join("docs", page.file.src_uri))

    def replace(match: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(folder, match[1]))
        if target.startswith("docs/"):
            return match[0]
        return f"]({config.repo_url}/blob/main/{target}{match[2]})"

    return LINK.sub(replace, markdown)


def on_page_content(html: str, **_: Any) -> str:
    """Let names of files in narrow columns of tables break after / and : only."""
    return CODE.sub(lambda match: re.sub(r"(?<=\w[/:])(?=\w)", "<wbr>", match[0]), html)
