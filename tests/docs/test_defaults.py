"""docs/defaults.md: every setting, once, with the default that the code has. docs/paper-map.md: the values of two presets."""

import json
import re
from operator import attrgetter
from pathlib import Path

from splatreel.config import Config, preset

ROOT = Path(__file__).parent.parent.parent
PAGE = (ROOT / "docs" / "defaults.md").read_text(encoding="utf-8")


def defaults() -> dict[str, str]:
    """Return the default of each setting as text. The paper's codec and settings that choose no quality are left out."""
    found = {}
    for name, value in json.loads(Config().to_json()).items():
        parts = {f"{name}.{key}": inner for key, inner in value.items()} if isinstance(value, dict) else {name: value}
        found |= {key: str(inner) for key, inner in parts.items()}
    return {
        key: value for key, value in found.items() if key not in ("region", "seed", "encode.renditions", "encode.h265")
    }


def test_every_setting_is_listed_once_with_its_default() -> None:
    listed = re.findall(r"^\| `([a-z_.0-9]+)` \| (\S+) \|", PAGE, re.M)
    assert sorted(name for name, _ in listed) == sorted(defaults())
    assert dict(listed) == defaults()


def test_every_row_says_where_and_on_what() -> None:
    measured = PAGE[PAGE.index("## Chosen by measurement") : PAGE.index("## Of the paper")]
    rows = [line.split(" | ") for line in measured.splitlines() if line.startswith("| `")]
    assert len(rows) > 30
    assert [cells[0] for cells in rows if len(cells) != 5 or not all(cell.strip(" |") for cell in cells)] == []
    assert [cells[0] for cells in rows if "](" not in cells[4]] == []


SECTIONS = {
    "GroupConfig": "group",
    "KeyframeConfig": "keyframe",
    "LayeringConfig": "layering",
    "EncodeConfig": "encode",
    "H265Config": "encode.h265",
}


def leading_numbers(cell: str) -> list[float]:
    """Return the numbers that a cell of the paper map starts with, such as 8, 12 of `8, 12; others`."""
    found = re.match(r"[0-9][0-9. ]*(?:e-[0-9]+)?(?:, ?[0-9]+)*", cell)
    return [] if found is None else [float(part.replace(" ", "")) for part in found[0].rstrip(" .").split(",")]


def test_the_paper_map_has_the_values_of_both_presets() -> None:
    page = (ROOT / "docs" / "paper-map.md").read_text(encoding="utf-8")
    rows = page[page.index("## Section 5.1 and appendix A") : page.index("## Ablations")].splitlines()
    compared = 0
    for cells in [line.strip("| ").split(" | ") for line in rows if line.startswith("| ")]:
        names = [f"{SECTIONS[owner]}.{name}" for owner, name in re.findall(r"`(\w+Config)\.(\w+)`", cells[2])]
        if cells[2].startswith("`") and names:
            for cell, config in ((cells[1], preset("paper")), (cells[3], Config())):
                shown = leading_numbers(cell)
                assert not shown or shown == [attrgetter(name)(config) for name in names], cells
                compared += len(shown)
    assert compared >= 30
