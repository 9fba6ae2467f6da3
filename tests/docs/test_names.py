"""The documents name classes' methods and fields, files and verbs: all of them exist."""

import ast
import re
from pathlib import Path

import pytest

from splatreel.config import Config, preset
from splatreel.config.settings import sections, settings

ROOT = Path(__file__).parent.parent.parent
SOURCE = ROOT / "src" / "splatreel"
DOCUMENTS = sorted([*(ROOT / "docs").rglob("*.md"), *ROOT.glob("*.md"), *(ROOT / "player").glob("*.md")])
FROZEN = ROOT / "docs" / "history"
"""Documents that keep the names of their time."""
MEMBER = re.compile(r"`([A-Z][A-Za-z0-9]+)\.([a-z_]\w*)`")
LINK = re.compile(r"\]\((?!https?:)([^)#]*)(?:#([^)]+))?\)")


def members() -> set[tuple[str, str]]:
    """(class, method or field) of every class in the package."""
    found = set()
    for path in SOURCE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                for item in node.body:
                    if isinstance(item, ast.FunctionDef):
                        found.add((node.name, item.name))
                    elif isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name):
                        found.add((node.name, item.target.id))
    return found


def anchors(document: Path) -> set[str]:
    """The anchors that GitHub gives a document's headings."""
    headings = re.findall(r"^#+ (.*)$", document.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_links_of_a_document_lead_somewhere(document: Path) -> None:
    """Also to a heading that is there."""
    missing = []
    for link, anchor in LINK.findall(document.read_text(encoding="utf-8")):
        target = document.parent / link if link else document
        if not target.exists() or (anchor and anchor not in anchors(target)):
            missing.append(f"{link}#{anchor}")
    assert not missing


def test_members_that_documents_name_exist() -> None:
    known = members()
    for document in DOCUMENTS:
        if FROZEN not in document.parents:
            named = MEMBER.findall(document.read_text(encoding="utf-8"))
            missing = [f"{owner}.{name}" for owner, name in named if (owner, name) not in known]
            assert not missing, document


def test_settings_that_documents_name_exist() -> None:
    for document in DOCUMENTS:
        if FROZEN not in document.parents and document.name != "CHANGELOG.md":
            text = document.read_text(encoding="utf-8")
            named = set(re.findall(r"`((?:group|keyframe|layering|encode)\.[a-z_0-9.]+)[`=]", text))
            assert sorted(named - settings().keys() - sections().keys()) == [], document


def test_differences_from_the_paper_have_every_setting_that_turns_one_off() -> None:
    """Settings whose defaults differ from the paper's, but for those of long videos."""
    text = (ROOT / "docs" / "differences.md").read_text(encoding="utf-8")
    paper = preset("paper")
    changed = {name for name, setting in settings().items() if setting.of(paper) != setting.of(Config())}
    assert len(changed) > 30
    assert sorted(name for name in changed - {"chapter_frames"} if f"`{name}`" not in text) == []
