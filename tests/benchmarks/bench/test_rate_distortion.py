"""Bytes against quality of one run in many encodings."""

import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from bench import rate_distortion
from bench.rate_chart import rate_chart
from bench.rate_distortion import (
    RatePoint,
    bd_rate,
    bytes_at,
    curves,
    rate_distortion_points,
    sweep_of,
    table,
)
from splatreel.base.errors import MissingDependencyError, UsageError
from tests.evaluation import scenes

NAMES = ["paper", "predictive 0.3 (--rate high)", "predictive 4"]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return scenes.write_run(tmp_path_factory.mktemp("rates") / "run")


def test_sweep_refuses_training_cameras(run: Path) -> None:
    with pytest.raises(UsageError, match=r"was trained on cam01, cam02, so they are not held out"):
        sweep_of(run, scenes.capture(run, held_out=["cam01", "cam02"]), 2)


def test_sweep_measures_each_configuration_once(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    record, capture = tmp_path / "out" / "codec.jsonl", scenes.capture(run)
    rows = rate_distortion_points(sweep_of(run, capture, 2, record=record), NAMES)
    assert [row.name for row in rows] == NAMES
    paper, fine, coarse = rows
    assert coarse.bytes < fine.bytes < paper.bytes
    assert coarse.loss > fine.loss > -0.1
    assert fine.psnr > 40  # the capture films the very points, to 8 bits
    assert paper.offset_bytes == paper.sections["group"]["offsets"]

    def nothing(*_: object) -> None:
        raise AssertionError("measured again")

    monkeypatch.setattr(rate_distortion, "reencode", nothing)
    assert rate_distortion_points(sweep_of(run, capture, 2, record=record), NAMES) == rows
    with pytest.raises(AssertionError, match="measured again"):
        rate_distortion_points(sweep_of(run, capture, 3, record=record), NAMES)
    text = table(rows)
    assert f"| predictive 4 | {coarse.bytes / 1e6:.3f} |" in text
    assert "BD-rate: the two have no quality in common." in text  # of the paper's codec there is but one row
    record.write_text("{}\n")
    with pytest.raises(UsageError, match=r"codec.jsonl: is damaged"):
        sweep_of(run, capture, 2, record=record)


def test_unknown_configuration_is_named(run: Path) -> None:
    with pytest.raises(UsageError, match=r"No configuration is called 'best'\. Known are paper, "):
        rate_distortion_points(sweep_of(run, scenes.capture(run), 5), ["best"])


def test_bd_rate_known_answers() -> None:
    curve = [(1e6, 30.0), (2e6, 31.0), (4e6, 31.8), (8e6, 32.0)]
    assert bd_rate(curve, curve) == pytest.approx(0)
    assert bd_rate(curve, [(size / 2, quality) for size, quality in curve]) == pytest.approx(-0.5)
    assert bd_rate([(size / 2, quality) for size, quality in curve], curve) == pytest.approx(1)
    beaten = [*curve, (9e6, 29.0)]
    assert bd_rate(curve, beaten) == pytest.approx(0)
    assert bd_rate(curve, [(1e5, 20.0), (2e5, 25.0)]) is None
    assert bd_rate(curve, [(1e5, 31.0)]) is None


def test_bytes_at_interpolates_sizes() -> None:
    rows = [RatePoint("x", size, 0, 30 - loss, loss, {}) for size, loss in ((1000, 0.1), (4000, 0.0))]
    assert bytes_at(rows, 0.05) == pytest.approx(2000)
    assert bytes_at(rows, 0.2) is None
    assert bytes_at([*rows, RatePoint("x", 2000, 0, 30, -0.1, {})], 0.0) == pytest.approx(1000 * 2**0.5)
    assert curves(rows) == {"paper": [], "predictive": []}


def test_rate_chart_draws_every_point() -> None:
    pytest.importorskip("matplotlib")
    drawing = rate_chart({"a <b>": [(1e5, 30.0), (2e6, 31.0)], "c": [(3e5, 30.5)]}, "R & D")
    assert ElementTree.fromstring(drawing).tag.endswith("svg")
    assert drawing.count("<use ") >= 3


def test_rate_chart_names_the_missing_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(MissingDependencyError, match=r"splatreel\[plots\]"):
        rate_chart({"a": [(1e5, 30.0)]}, "R & D")
