"""The documentation site, without building it: its navigation and its reference name what exists."""

import importlib
import re
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parent.parent.parent
DOCS = ROOT / "docs"
REFERENCE = sorted((DOCS / "reference").glob("*.md"))


def navigation() -> list[str]:
    """Return the files that mkdocs.yml puts into the navigation."""
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    return re.findall(r": ([\w./-]+\.md)$", text.partition("\nnav:")[2].partition("\n\n")[0], re.MULTILINE)


def resolve(identifier: str) -> Any:
    """Return the module, class or function of a dotted name."""
    parts = identifier.split(".")
    for cut in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:cut]))
        except ModuleNotFoundError:
            continue
        for name in parts[cut:]:
            found = getattr(found, name)
        return found
    raise ModuleNotFoundError(identifier)


def test_navigation_has_every_page() -> None:
    pages = {path.relative_to(DOCS).as_posix() for path in (*DOCS.glob("*.md"), *REFERENCE)}
    assert set(navigation()) == pages | {"experiments/README.md"}


@pytest.mark.parametrize("page", REFERENCE, ids=lambda path: path.stem)
def test_reference_names_what_exists(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    named = re.findall(r"^::: (\S+)$", text, re.MULTILINE) + re.findall(r"\]\[(splatreel\.[\w.]+)\]", text)
    assert named
    for identifier in named:
        resolve(identifier)


def test_reference_has_every_public_name() -> None:
    import splatreel

    text = (DOCS / "reference" / "index.md").read_text(encoding="utf-8")
    assert [name for name in splatreel.__all__ if f"[`{name}`][" not in text] == []


def test_site_is_of_the_repository() -> None:
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    (address,) = re.findall(r"^repo_url: (\S+)$", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"), re.MULTILINE)
    assert f'Repository = "{address}"' in project
