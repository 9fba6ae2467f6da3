"""The documents name classes' methods and fields, files and verbs: all of them exist."""

import ast
import dataclasses
import re
from pathlib import Path

import pytest

from splatreel.config import EncodeConfig, GroupConfig, KeyframeConfig, LayeringConfig

ROOT = Path(__file__).parent.parent.parent
SOURCE = ROOT / "src" / "splatreel"
DOCUMENTS = sorted([*(ROOT / "docs").glob("*.md"), *ROOT.glob("*.md")])
MEMBER = re.compile(r"`([A-Z][A-Za-z0-9]+)\.([a-z_]\w*)`")
LINK = re.compile(r"\]\((?!https?:|#)([^)#]+)")


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


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_members_and_links_of_a_document_exist(document: Path) -> None:
    text, known = document.read_text(encoding="utf-8"), members()
    missing = [f"{owner}.{name}" for owner, name in MEMBER.findall(text) if (owner, name) not in known]
    missing += [link for link in LINK.findall(text) if not (document.parent / link).exists()]
    assert not missing


def test_the_paper_map_names_every_hyper_parameter() -> None:
    """Whatever a configuration can say stands in the map, or is ours and stands in the design."""
    text = "".join((ROOT / "docs" / name).read_text(encoding="utf-8") for name in ("paper-map.md", "design.md"))
    owners = (LayeringConfig, KeyframeConfig, GroupConfig, EncodeConfig)
    fields = {(owner.__name__, field.name) for owner in owners for field in dataclasses.fields(owner)}
    assert len(fields) > 30
    assert sorted(fields - set(MEMBER.findall(text))) == []
