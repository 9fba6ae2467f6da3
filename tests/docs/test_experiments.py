"""Experiments are small dated files, and the index has a line for each."""

import re
from pathlib import Path

FOLDER = Path(__file__).parent.parent.parent / "docs" / "experiments"
INDEX = FOLDER / "README.md"
MAX_LINES = 60  # CONTRIBUTING.md asks for 40


def rows() -> list[list[str]]:
    """The cells of each decision."""
    lines = [line for line in INDEX.read_text(encoding="utf-8").splitlines() if line.startswith("| ")]
    return [
        [cell.strip() for cell in line.strip("|").split("|")] for line in lines if not line.startswith("| question")
    ]


def test_every_decision_has_its_numbers_and_where_they_were_measured() -> None:
    assert len(rows()) >= 40
    for cells in rows():
        assert len(cells) == 4, cells
        assert cells[0].endswith("?") or "? (" in cells[0], cells
        assert re.search(r"\]\([^)]+\.md(#[^)]+)?\)", cells[3]), cells
        assert all(cells), cells


def test_experiments_are_dated_small_and_in_the_index() -> None:
    index = INDEX.read_text(encoding="utf-8")
    for path in sorted(FOLDER.iterdir()):
        if path != INDEX:
            assert re.fullmatch(r"\d{4}-\d{2}-\d{2}-[a-z0-9-]+\.md", path.name), path.name
            assert f"]({path.name}" in index, f"{path.name} has no line in {INDEX.name}"
            assert len(path.read_text(encoding="utf-8").splitlines()) <= MAX_LINES, path.name
