"""The tables of docs/defaults.md and docs/paper-map.md are those of the declarations of the settings."""

import importlib
import re
from pathlib import Path
from types import ModuleType

import pytest

from splatreel.config import Config, preset
from splatreel.config.settings import settings

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture
def page(benchmarks: Path) -> ModuleType:
    return importlib.import_module("settings_page")


def rows(table: str) -> list[list[str]]:
    """Return the cells of a table's rows, without its head."""
    return [[cell.strip() for cell in line[1:-1].split(" | ")] for line in table.splitlines()[2:]]


def test_the_pages_have_the_present_tables(page: ModuleType) -> None:
    old = [path.name for path, text in page.documents() if text != path.read_text(encoding="utf-8")]
    assert old == [], "Settings have changed. Run: python benchmarks/settings_page.py"


def test_every_setting_that_decides_quality_is_listed_once_with_its_default(page: ModuleType) -> None:
    table, papers, others = page.defaults_table().split("\n\n")
    listed = {cells[0].strip("`"): cells[1:] for cells in rows(table)}
    assert listed["group.progressive_share"][:2] == ["0.0", "0.5"]
    assert listed["keyframe.detail"][:2] == ["true", "false"]
    assert listed["layering.flow"][3:] == ["0", "[1](experiments/2026-11-26-gmflow.md)"]
    unmeasured = {text: re.findall(r"`([\w.]+)=[^`]*`", text) for text in (papers, others)}
    names = [*listed, *unmeasured[papers], *unmeasured[others]]
    assert sorted(names) == sorted(name for name in settings() if name not in page.WITHOUT_QUALITY)
    assert "`group.lambda_temporal=0.01`" in papers
    assert "`layering.lift=vote`" in others


def test_most_defaults_were_measured_and_say_where() -> None:
    chosen = {name: setting.chosen for name, setting in settings().items() if setting.chosen is not None}
    assert len(chosen) > 35
    for name, measurements in chosen.items():
        assert measurements.captures, name
        assert re.fullmatch(r"\d.*", measurements.seeds), name
        assert measurements.measured, name
        assert all((DOCS / address.partition("#")[0]).is_file() for address in measurements.measured), name


def test_the_papers_table_has_the_values_of_both_presets(page: ModuleType) -> None:
    found = {cells[2]: cells for cells in rows(page.paper_table())}
    assert found["`group.length`"] == ["group length", "30; MeetRoom 20", "`group.length`", "30"]
    assert found["`keyframe.first_iterations`"][1::2] == [
        "20000",
        "0: 1000, and 7.5 for each frame of the video, at most 4000",
    ]
    for setting in settings().values():
        if setting.paper is not None:
            assert found[f"`{setting.name}`"][1].startswith(str(setting.of(preset("paper"))))
            assert found[f"`{setting.name}`"][3].startswith(str(setting.of(Config())))
