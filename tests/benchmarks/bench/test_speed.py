"""Speed measurements of a tiny capture, and their ratios."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import measure
from bench import speed
from bench.provenance import append, label
from bench.speed import bench_reconstruct
from splatreel.base.errors import UsageError
from splatreel.codec.reader import ReelReader
from splatreel.config import Config, preset
from tests.method.captures import WallCapture


def config(iterations: int) -> Config:
    draft = preset("draft")
    keyframe = replace(draft.keyframe, first_iterations=60, refine_iterations=5)
    group = replace(draft.group, length=4, overlap=1, iterations_per_frame=iterations)
    return replace(draft, keyframe=keyframe, group=group)


@pytest.mark.slow
def test_bench_reconstruct_reports_all_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def medians(works: list[Callable[[], None]], repeats: int) -> list[float]:
        """Return times of a layered batch, of whole images, and on one thread."""
        assert repeats == 1
        for work in works:
            work()
        return [16.0, 40.0, 56.0]

    monkeypatch.setattr(speed, "medians_ms", medians)
    capture = WallCapture(4, speed=0.3)
    capture.held_out = ["cam03"]
    rows: list[dict[str, Any]] = bench_reconstruct(
        capture, tmp_path, {"quick": config(4), "long": config(8)}, device="cpu", loop=8, repeats=1
    )
    quick, iteration, looped, long = rows
    assert [row["what"] for row in rows] == ["quick", "group iteration", "quick looped", "long"]
    assert quick["seconds"] > 0
    assert quick["seconds_a_frame"] == pytest.approx(quick["seconds"] / 4, abs=0.02)
    megapixels = capture.width * capture.height / 1e6
    assert quick["seconds_a_megapixel"] == pytest.approx(quick["seconds_a_frame"] / megapixels, rel=0.01)
    assert quick["peak_memory_mb"] > 50
    assert quick["psnr"] > 10
    group = ReelReader(tmp_path / "quick" / "reel").group(0)
    assert (iteration["points"], iteration["still"]) == (len(group.dynamic), group.alive.sum())
    assert 0 < iteration["tiles"] <= 1
    assert (iteration["ms"], iteration["undivided"]) == (16 / speed.BATCH, 2.5)
    assert iteration["one_thread"] == 3.5
    assert looped["frames"] == 8
    assert looped["more_memory_mb"] >= 0
    assert long["times_as_long"] == round(long["seconds"] / quick["seconds"], 2)
    assert long["psnr_more"] == pytest.approx(long["psnr"] - quick["psnr"], abs=0.002)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["long", "quick", "quick-looped"]
    made = label(capture, "cpu")
    append(tmp_path / "bench.jsonl", made, rows)
    append(tmp_path / "bench.jsonl", made, rows[:1])
    lines = [json.loads(line) for line in (tmp_path / "bench.jsonl").read_text().splitlines()]
    assert [line["what"] for line in lines] == [*[row["what"] for row in rows], "quick"]
    assert {(line["capture"], line["cameras"], line["width"], line["device"]) for line in lines} == {
        ("wall", 3, capture.width, "cpu")
    }
    assert lines[2]["frames"] == 8  # of the row, not of the capture


def test_loop_shorter_than_the_capture_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="--loop 4 is out of range: the capture has 4 frames"):
        bench_reconstruct(WallCapture(4), tmp_path, {"quick": config(4)}, loop=4)
    assert not list(tmp_path.iterdir())


def test_bench_reconstruct_refuses_invalid_options() -> None:
    for options in (["--repeats", "0"], ["--against", "standard"]):
        with pytest.raises(UsageError, match=r"measure\.py reconstruct needs --repeats 1 or more"):
            measure.app.cli(args=["reconstruct", "capture", "--out", "x", *options])
