"""Links out of docs/: on the site they lead to the repository, where those files are."""

import posixpath
import re
from typing import Any

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
