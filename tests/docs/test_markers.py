"""The markers of tests: registered, described in CONTRIBUTING.md, and left out of `make test` where both say so."""

import re
import tomllib
from pathlib import Path

from tests import conftest

ROOT = Path(__file__).parent.parent.parent
SETTINGS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["pytest"]["ini_options"]
REGISTERED = dict(line.split(": ", 1) for line in SETTINGS["markers"])


def test_the_guide_describes_every_marker() -> None:
    guide = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| `(\w+)` \| .* \| (yes|no) \|$", guide, re.MULTILINE))
    assert set(rows) == set(REGISTERED)
    left_out = {name for name, answer in rows.items() if answer == "no"}
    assert left_out == {name for name, text in REGISTERED.items() if text.endswith("; not in make test")}
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    (expression,) = re.findall(r"^LONG := (.*)$", makefile, re.MULTILINE)
    assert set(expression.split(" or ")) == left_out


def test_every_marker_is_used() -> None:
    sources = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("test_*.py"))
    assert [name for name in REGISTERED if f"pytest.mark.{name}\n" not in sources] == []


def test_files_that_are_scheduled_by_name_exist() -> None:
    assert [path for path in (*conftest.FIRST, *conftest.TOGETHER) if not (ROOT / path).is_file()] == []
    assert len({conftest.group_of(f"{path}::test_it") for path in conftest.TOGETHER}) == 1
