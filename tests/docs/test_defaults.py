"""docs/defaults.md: every setting, once, with the default that the code has."""

import json
import re
from pathlib import Path

from splatreel.config import Config

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
