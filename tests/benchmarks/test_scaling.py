"""The measurement of scaling: what is measured again and what not, exponents, the page, the plot, and memory by group."""

import importlib
import json
import mmap
import time
import xml.etree.ElementTree as ET
from collections.abc import Callable
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

Row = dict[str, Any]
WARM_UP = ("write_film", "measure", "measure")
"""What is called for kernels to be compiled."""
SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture
def scaling(benchmarks: Path) -> ModuleType:
    return importlib.import_module("scaling")


@pytest.fixture
def page(benchmarks: Path) -> ModuleType:
    return importlib.import_module("scaling_page")


@pytest.fixture
def measured(scaling: ModuleType, tmp_path: Path) -> Callable[..., tuple[bool, list[str]]]:
    """A function that measures the tiny cases with stand-ins: whether any failed, and what was called, in order."""

    def run(axis: str, note: str = "", killed: tuple[int, ...] = ()) -> tuple[bool, list[str]]:
        called = []

        def apart(function: Callable, *arguments: Any) -> Row:
            called.append(function.__name__)
            if function is scaling.write_film:
                arguments[0].mkdir(parents=True)
            elif arguments[0].width in killed:
                raise BrokenProcessPool("killed")
            return result(arguments[0]) if function is scaling.measure else {}

        cases = scaling.TINY.cases()
        bench = scaling.Bench(tmp_path, tmp_path / "results.jsonl", note, scaling.longest(cases), apart)
        return bench.run([case for case in cases if case.axis == axis]), called

    return run


def result(case: Any) -> Row:
    """Return a result like `measure`: seconds in proportion to pixels and frames, memory to the square root of pixels."""
    seconds = case.width**2 * case.frames / 1000
    stages = {"keyframe": 0.75 * seconds, "group": 0.25 * seconds}
    found = {"cores": 2, "seconds": stages, "seconds_total": seconds, "seconds_wall": seconds, "processor": seconds}
    return found | {"memory_mb": 10.0 * case.width, "points": 12, "memory_mb_by_group": [1, 100, 110, 104]}


def test_a_case_is_measured_once_for_each_source_and_note(
    scaling: ModuleType, measured: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert measured("pixels") == (False, ["write_film", *WARM_UP, "measure", "write_film", "measure"])
    lines = [json.loads(line) for line in (tmp_path / "results.jsonl").read_text().splitlines()]
    assert [line["benchmark"] for line in lines] == ["scaling pixels 0.0017", "scaling pixels 0.0031"]
    assert {"revision", "threads", "seconds_wall", "memory_mb", "machine_before", "source"} <= set(lines[0])
    assert measured("pixels") == (False, [])
    assert measured("pixels", note="again") == (False, ["measure"] * 4)
    monkeypatch.setattr(scaling, "source", lambda: "another")
    assert measured("pixels") == (False, ["measure"] * 4)


def test_a_case_that_is_killed_is_measured_by_the_next_call(measured: Callable) -> None:
    assert measured("pixels", killed=(48,)) == (True, ["write_film", *WARM_UP, "measure", "write_film", "measure"])
    assert measured("pixels") == (False, ["measure"] * 3)
    assert measured("pixels") == (False, [])


def test_the_usual_cases_are_those_that_were_asked_for(scaling: ModuleType, page: ModuleType) -> None:
    cases = scaling.Sizes().cases()
    values = {axis: [page.value_of(axis, case.row()) for case in cases if case.axis == axis] for axis in page.AXES}
    assert values == {
        "pixels": ["0.1", "0.4", "1.4", "5"],
        "cameras": ["8", "18", "40"],
        "threads": ["1", "2", "4"],
        "workers": ["1", "2", "4"],
        "frames": ["30", "300", "3000"],
    }
    assert all(case.width % 8 == 0 and case.cameras % 2 == 0 for case in cases)  # videos have even sizes
    assert scaling.longest(cases)[368, 8] == 24
    assert len({case.name for case in cases}) == len(cases)


def test_exponents_are_slopes(page: ModuleType) -> None:
    assert page.exponent([(x, 3 * x**1.5) for x in (0.1, 0.4, 5)]) == pytest.approx(1.5)
    assert page.exponent([(1, 8), (2, 4), (4, 4)]) == pytest.approx(-0.5)
    assert page.exponent([(1, 2)]) is None
    assert page.exponent([(2, 1), (2, 3)]) is None
    assert page.exponent([(1, 0), (2, 3)]) is None


def test_the_page_has_tables_exponents_and_what_memory_does(
    page: ModuleType, measured: Callable, tmp_path: Path
) -> None:
    assert page.page(page.records(tmp_path / "none.jsonl")) == page.MISSING
    for axis in ("pixels", "frames"):
        measured(axis)
    found = page.records(tmp_path / "results.jsonl")
    lines = page.page(found).splitlines()
    assert "| megapixels | 0.0017, 0.0031 | 1.00 | 1.00 | 0.50 | 0.50 |" in lines
    assert "| frames | 6, 12 | 1.00 | 1.00 | 0.00 | 0.00 |" in lines
    assert "| cameras | not measured | not known | not known | not known | not known |" in lines
    assert any(line.startswith("| megapixels 0.0017 | 48x36 | 4 | 3 | 2 | 6.9 | 480 | 12 |") for line in lines)
    slopes = "keyframe 1.00 (75 % of the last), group 1.00 (25 % of the last)."
    assert f"- Exponents of the seconds of stages, by pixels: {slopes}" in lines
    (memory,) = [line for line in lines if line.startswith("- Memory from group 2 to group 4 of 12 frames")]
    assert "100 MB to 104 MB, +4.0 %, within the 5 %" in memory
    assert "no group took more than 110 MB (+10.0 %)" in memory
    assert lines[-1].startswith("Measured on ")


def test_more_threads_than_cores_are_shown_and_not_fitted(page: ModuleType, measured: Callable, tmp_path: Path) -> None:
    measured("threads")
    found = page.records(tmp_path / "results.jsonl")
    one, two = found["threads"]
    found["threads"] += [two | {"threads": 4, "seconds_wall": 2 * one["seconds_wall"]}]
    text = page.page(found)
    assert "| threads | 1, 2, 4 | 0.00 | 0.00 |" in text
    assert "| threads 4 | 48x36 | 4 | 3 | 4, on 2 cores |" in text
    assert ">(4)<" in page.plot(found)


def test_the_plot_has_a_chart_of_time_and_of_memory_for_each_axis(
    page: ModuleType, measured: Callable, tmp_path: Path
) -> None:
    measured("pixels")
    root = ET.fromstring(page.plot(page.records(tmp_path / "results.jsonl")))
    texts = [text.text for text in root.iter(f"{SVG}text")]
    assert texts.count("megapixels") == 2
    assert {"seconds", "memory, MB", "exponent 1.00", "exponent 0.50", "0.0017"} <= set(texts)
    _, _, wide, high = map(float, root.attrib["viewBox"].split())
    places = [(float(c.attrib["cx"]), float(c.attrib["cy"])) for c in root.iter(f"{SVG}circle")]
    assert len(places) == 4
    assert all(0 < x < wide and 0 < y < high for x, y in places)
    assert places[0][0] < places[1][0]
    assert places[0][1] > places[1][1]  # more is higher up


def test_the_page_shows_the_recorded_results(page: ModuleType) -> None:
    found, text = page.records(), page.PAGE.read_text(encoding="utf-8")
    assert text == page.replaced(text, page.page(found)), "run: python benchmarks/scaling.py --show"
    if any(found.values()):
        assert page.PLOT.read_text(encoding="utf-8") == page.plot(found), "run: python benchmarks/scaling.py --show"
    with pytest.raises(ValueError, match="no place for results"):
        page.replaced("nothing here", "new")


def test_memory_is_that_of_the_time_between_ends(benchmarks: Path) -> None:
    resident = importlib.import_module("resident")
    with resident.Resident() as watch:
        time.sleep(0.5)
        before = time.time()
        held = mmap.mmap(-1, 64_000_000)  # malloc may have such memory left from an earlier test
        np.frombuffer(held, np.uint8)[:] = 1
        time.sleep(0.5)
        after = time.time()
    first, second = watch.peaks([before, after])
    assert len(held) * 0.9 < second - first < len(held) * 1.5
    assert watch.peak() >= second
    assert watch.peaks([0.0, 1.0]) == [0, 0]


def test_walls_have_any_even_number_of_cameras(benchmarks: Path) -> None:
    kitchen = importlib.import_module("kitchen")
    usual = np.stack([camera.center for camera in kitchen.wall(64, 48)])
    for columns in (2, 4, 20):
        centers = np.stack([camera.center for camera in kitchen.wall(64, 48, columns)])
        assert len(np.unique(centers, axis=0)) == 2 * columns
        np.testing.assert_allclose(centers.min(0), usual.min(0), atol=0.15)
        np.testing.assert_allclose(centers.max(0), usual.max(0), atol=0.15)
