"""The glossary names existing code, and the documentation uses its terms instead of their synonyms."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "src" / "splatreel"
GLOSSARY = ROOT / "docs" / "glossary.md"
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]


def glossary_rows() -> list[list[str]]:
    """Return the cells of each row: term, meaning, code, synonyms."""
    lines = [line for line in GLOSSARY.read_text(encoding="utf-8").splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[1:]]


def prose(text: str) -> str:
    """Return Markdown without code, link targets and line breaks."""
    text = re.sub(r"```.*?```|^    .*?$", "", text, flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"`[^`]*`|\]\([^)]*\)", " ", text)
    return re.sub(r"\s+", " ", text)


def synonyms_in(text: str) -> list[str]:
    found, plain = [], prose(text)
    for term, _, _, synonyms in glossary_rows():
        for synonym in synonyms.split(", "):
            pattern = rf"\b{re.escape(synonym)}(s|es)?\b"
            if match := re.search(pattern, plain, re.IGNORECASE):
                found.append(f"{match[0]!r}: write {term!r}")
    return found


def test_glossary_has_complete_unique_rows() -> None:
    rows = glossary_rows()
    assert len(rows) >= 30
    assert all(len(row) == 4 and all(row) for row in rows)
    assert len({row[0] for row in rows}) == len(rows)


def test_glossary_names_existing_code() -> None:
    missing = []
    for term, _, code, _ in glossary_rows():
        file, _, name = code.strip("`").partition(":")
        path = SOURCE / file if (SOURCE / file).exists() else ROOT / file
        names = ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if path.is_file() else []
        defined = {node.name for node in names if isinstance(node, ast.FunctionDef | ast.ClassDef)}
        if not path.is_file() or (name and name not in defined):
            missing.append(f"{term}: {code}")
    assert not missing


@pytest.mark.parametrize("page", [page for page in PAGES if page != GLOSSARY], ids=lambda page: page.name)
def test_documentation_uses_no_synonyms(page: Path) -> None:
    assert synonyms_in(page.read_text(encoding="utf-8")) == []


def test_synonyms_are_found_across_lines_but_not_in_code() -> None:
    assert synonyms_in("Each key\nframes is stored.") == ["'key frames': write 'keyframe'"]
    assert synonyms_in("The option `new view` and\n\n    key frame\n") == []
