"""The glossary names existing code, and the documentation uses its terms instead of their synonyms."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "src" / "splatreel"
GLOSSARY = ROOT / "docs" / "glossary.md"
ALLOWED = {"snapshot": "state of training in memory, to which training returns after an error"}
"""Synonyms that identifiers may contain, with their other meaning."""
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


def identifiers(source: str) -> set[str]:
    """Return the names that Python code defines or uses."""
    fields = [
        getattr(node, field, None) for node in ast.walk(ast.parse(source)) for field in ("name", "arg", "id", "attr")
    ]
    return {field for field in fields if isinstance(field, str)}


def synonyms_in_identifiers(names: set[str]) -> list[str]:
    texts = {name: " ".join(re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name)).lower() for name in names}
    found = []
    for term, _, _, synonyms in glossary_rows():
        for synonym in set(synonyms.lower().replace("-", " ").split(", ")) - ALLOWED.keys():
            pattern = re.compile(rf"\b{re.escape(synonym)}(s|es)?\b")
            found += [f"{name}: write {term!r}" for name, text in texts.items() if pattern.search(text)]
    return sorted(found)


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


def test_identifiers_use_no_synonyms() -> None:
    found = []
    for path in SOURCE.rglob("*.py"):
        names = identifiers(path.read_text(encoding="utf-8")) | {path.stem}
        found += [f"{path.relative_to(SOURCE)}: {fault}" for fault in synonyms_in_identifiers(names)]
    assert not found, "\n".join(found)


def test_synonyms_are_found_in_identifiers() -> None:
    names = identifiers("class RestingPoints: ...\ndef key_frame(is_frame, episode_2): keyframe.snapshot")
    found = ["RestingPoints: write 'static point'", "episode_2: write 'chapter'", "key_frame: write 'keyframe'"]
    assert synonyms_in_identifiers(names) == found
