"""The tree in docs/architecture.md and the table of typical changes in docs/changing.md are those of the repository."""

import re
from pathlib import Path

import pytest

from tests.test_house import RUNGS
from tests.test_typescript import LADDER, PACKAGES, ROOMS

ROOT = Path(__file__).parent.parent.parent
SOURCE = ROOT / "src" / "splatreel"
ARCHITECTURE, CHANGING = (
    (ROOT / "docs" / name).read_text(encoding="utf-8") for name in ("architecture.md", "changing.md")
)
FOLDER = re.compile(r"^    ((?:  )*)(\S+)/  +(\S.*)$", re.MULTILINE)
PATH = re.compile(r"`([\w./-]+/[\w./-]*)`")


def folders_of_the_tree() -> dict[str, str]:
    """Return the description of each folder in the tree. A folder lies in the last one before it that is indented less."""
    found: dict[str, str] = {}
    above: list[str] = []
    for indent, name, holds in FOLDER.findall(ARCHITECTURE):
        above = [*above[: len(indent) // 2], name]
        found["/".join(above)] = holds
    return found


def folders_of_the_repository() -> set[str]:
    """Return the folders with Python files, of the built player, and of the packages' sources."""
    python = {path.parent for path in SOURCE.rglob("*.py")}
    typescript = {path.parent for root in PACKAGES.values() for path in root.rglob("*.ts")}
    return {path.relative_to(ROOT).as_posix() for path in python | typescript | {SOURCE / "play" / "static"}}


def changes() -> list[list[str]]:
    """The cells of the table's rows."""
    table = CHANGING.partition("| to change |")[2].partition("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table]


def test_the_tree_is_that_of_the_repository() -> None:
    assert set(folders_of_the_tree()) == folders_of_the_repository()


@pytest.mark.parametrize("cells", changes(), ids=lambda cells: cells[0])
def test_a_change_leads_to_files_that_exist(cells: list[str]) -> None:
    assert len(cells) == 3
    paths = PATH.findall(cells[1] + cells[2])
    assert PATH.search(cells[1]), "where to start"
    assert [path for path in paths if not (ROOT / path).exists() and not (SOURCE / path).exists()] == []


def test_there_are_enough_changes() -> None:
    assert len(changes()) >= 12


def test_the_order_of_imports_is_the_one_that_is_checked() -> None:
    rungs = [", ".join(name for name in RUNGS if RUNGS[name] == rung) for rung in range(RUNGS["cli"] + 1)]
    packages = [[", ".join(names) for names in rooms] for rooms in (LADDER, *ROOMS.values())]
    for order in (rungs, *packages):
        assert " < ".join(order) in ARCHITECTURE
