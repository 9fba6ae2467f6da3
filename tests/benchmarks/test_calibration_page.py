import importlib
import json
from pathlib import Path
from types import ModuleType

import pytest

PLACED = {
    "benchmark": "calibration kitchen",
    "learned": False,
    "cameras": 8,
    "neighbor_degrees": 3.3,
    "placed": 4,
    "rotation_degrees": {"median": 0.254, "max": 0.5},
    "position_percent": {"median": 0.64, "max": 0.86},
}


@pytest.fixture
def page(benchmarks: Path) -> ModuleType:
    return importlib.import_module("calibration_page")


def test_the_latest_record_of_each_case_is_shown(page: ModuleType, tmp_path: Path) -> None:
    refused = {"benchmark": "calibration yard", "learned": False, "cameras": 4, "neighbor_degrees": 38.8, "placed": 0}
    learned = (
        refused
        | {"learned": True, "placed": 3}
        | {key: PLACED[key] for key in ("rotation_degrees", "position_percent")}
    )
    same = (
        refused
        | {"same_lens": True, "placed": 4}
        | {key: PLACED[key] for key in ("rotation_degrees", "position_percent")}
    )
    older = PLACED | {"placed": 8}
    lines = [
        older,
        PLACED,
        refused,
        learned,
        same,
        {"benchmark": "kitchen", "psnr": 30.0},
        {"benchmark": "calibration old"},
    ]
    file = tmp_path / "results.jsonl"
    file.write_text("".join(json.dumps(line) + "\n" for line in lines))
    rows = page.table(page.latest(file)).splitlines()[2:]
    assert rows == [
        "| kitchen, a wall of cameras | 8 | 3 | 4 placed, 0.25°, 0.64 % | 4 placed, 0.25°, 0.64 % |  |",
        "| yard, an arc of 140 degrees | 4 | 39 | refused | 3 placed, 0.25°, 0.64 % | 4 placed, 0.25°, 0.64 % |",
    ]


def test_the_page_shows_what_is_recorded(page: ModuleType) -> None:
    text = page.PAGE.read_text(encoding="utf-8")
    assert text == page.replaced(text, page.table(page.latest())), "run: python benchmarks/calibration_page.py"


def test_a_page_without_its_place_is_refused(page: ModuleType) -> None:
    with pytest.raises(ValueError, match="no place for results"):
        page.replaced("nothing", "table")
