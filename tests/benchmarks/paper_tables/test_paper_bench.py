import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from paper_tables import paper_bench
from paper_tables.paper_bench import FULL, METHODS, PER_FRAME, PaperBench
from splatreel.base.errors import UsageError
from splatreel.base.progress import Silent
from splatreel.config import Config
from splatreel.run.estimate import Division, Estimate
from splatreel.run.pipeline import Result
from splatreel.run.store import StoredGroup, StoredLayer
from tests.benchmarks.baselines.starts import SECONDS, write_start
from tests.benchmarks.baselines.test_part_by_part import Clock, Sliding
from tests.evaluation import scenes


@pytest.fixture
def runs(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Path, Config]]:
    """Return the runs that were made. Each is the same small run, written without training."""
    made: list[tuple[Path, Config]] = []

    def reconstruct(capture, out: Path, config: Config, **_: object) -> Result:
        if not (out / "reel").exists():
            scenes.write_run(out)
            made.append((out, config))
        return Result(out / "reel", out / "work", {"keyframe": 30.0}, "cpu")

    monkeypatch.setattr(paper_bench, "reconstruct", reconstruct)
    return made


def bench(out: Path, config: Config | None = None) -> PaperBench:
    return PaperBench({"toy": scenes.capture(out)}, config or Config(), out, "cpu", Silent())


def test_reconstructions_are_shared_and_continued(runs: list, tmp_path: Path) -> None:
    first = bench(tmp_path).measure("toy", FULL)
    assert bench(tmp_path).measure("toy", FULL).report == first.report
    assert bench(tmp_path).measure("toy", "length 30").run == first.run  # the default length
    assert len(runs) == 1
    other = bench(tmp_path).measure("toy", "w/o Rfn.")
    assert [config.keyframe.refine_iterations for _, config in runs][1] == 1
    assert other.run != first.run
    assert first.minutes == pytest.approx(0.5)
    assert 0 < first.report.reel_bytes < first.float32_bytes


def test_record_has_a_line_for_each_variant_with_its_changes(runs: list, tmp_path: Path) -> None:
    made = bench(tmp_path)
    made.measure("toy", "w/o Adp.")
    (line,) = map(json.loads, made.record())
    assert (line["capture"], line["variant"], line["changes"]) == ("toy", "w/o Adp.", {"layering.adapt_every": 0})
    assert line["psnr"] > 30
    assert "per_frame" not in line


def test_baselines_start_from_the_variant_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def reconstruct(capture, out: Path, config: Config, **_: object) -> Result:
        start = write_start(capture, out)
        start.store.group(0).save_layer(StoredLayer(scenes.static(), scenes.static()))
        start.store.group(0).save_group(StoredGroup(scenes.group()))
        return Result(out / "reel", out / "work", SECONDS, "cpu")

    monkeypatch.setattr(paper_bench, "reconstruct", reconstruct)
    monkeypatch.setitem(METHODS, PER_FRAME, method := Sliding(Clock()))
    made = bench(tmp_path)
    found = made.measure("toy", PER_FRAME)
    assert method.trained == [1, 2, 3, 4]
    assert found.run != made.measure("toy", FULL).run
    assert found.report.seconds["first keyframe"] == 10
    variants = [json.loads(line)["variant"] for line in made.record()]
    assert (variants[0], variants[-1]) == (FULL, PER_FRAME)
    assert bench(tmp_path).measure("toy", PER_FRAME).report == found.report
    assert method.trained == [1, 2, 3, 4]
    limited = PaperBench({"toy": scenes.capture(tmp_path)}, Config(), tmp_path, "cpu", Silent(), minutes=1)
    assert limited.folder("toy", PER_FRAME) != made.folder("toy", PER_FRAME)
    assert limited.folder("toy", FULL) == made.folder("toy", FULL)


def test_plan_counts_what_is_finished(runs: list, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = bench(tmp_path)
    made.measure("toy", FULL)
    assert made.plan([FULL, "length 30"]) == "1 reconstructions, of which 1 are finished."


def test_short_plan_is_not_rounded_to_no_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seconds = Estimate({"group": 17.0}, 10**9, 0.1, Division(1, 1))
    monkeypatch.setattr(paper_bench, "estimate", lambda *_: seconds)
    monkeypatch.setattr(paper_bench, "measure_run_speed", lambda *_: None)
    plan = bench(tmp_path).plan([FULL, "w/o Reg."])
    assert "about 17 s, 1.0 GB" in plan
    assert "All: about 34 s" in plan


def test_captures_need_a_held_out_camera(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no camera is held out"):
        PaperBench({"toy": scenes.capture(tmp_path, [])}, Config(), tmp_path, "cpu", Silent())


def test_command_refuses_captures_of_one_name(benchmarks: Path, tmp_path: Path) -> None:
    from paper import main

    for folder in ("a", "b"):
        (tmp_path / folder / "film").mkdir(parents=True)
    paths = tuple(tmp_path / folder / "film" for folder in ("a", "b"))
    with pytest.raises(UsageError, match="captures with different folder names"):
        main(paths, out=tmp_path / "out", table=("6",))


@pytest.fixture
def measured(benchmarks: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[str]]:
    """Return a function that runs the command without reconstructions. It returns the frames, then the files with records."""
    import paper

    opened = []

    def open_capture(path: Path, width: int = 64, frames: tuple[int, int] = (0, 5)) -> SimpleNamespace:
        opened.append(frames)
        return SimpleNamespace(width=width, height=48, frames=frames[1] - frames[0], close=lambda: None)

    made = SimpleNamespace(plan=lambda _: "plan", record=list)
    monkeypatch.setattr(paper, "open_capture", open_capture)
    monkeypatch.setattr(paper, "PaperBench", lambda *_: made)
    monkeypatch.setattr(paper, "write_table", lambda *_: "a table")
    monkeypatch.setattr(paper, "RESULTS", tmp_path / "project.jsonl")
    (tmp_path / "out").mkdir()

    def run(**options: Any) -> list[str]:
        paper.main((tmp_path / "toy",), out=tmp_path / "out", table=("6",), **options)
        return [f"{opened[-1][0]}:{opened[-1][1]}", *sorted(path.name for path in tmp_path.rglob("*.jsonl"))]

    return run


def test_records_of_the_project_change_only_if_asked(measured: Callable) -> None:
    assert measured()[1:] == ["results.jsonl"]
    assert measured(record_=True)[1:] == ["project.jsonl", "results.jsonl"]


def test_frames_are_a_range_as_everywhere(measured: Callable) -> None:
    assert measured(frames="1:3")[0] == "1:3"
    assert measured(frames="1:300")[0] == "1:5"
    with pytest.raises(UsageError, match="is not a range of frames"):
        measured(frames="3")


def test_command_refuses_baselines_without_time(benchmarks: Path, tmp_path: Path) -> None:
    from paper import main

    with pytest.raises(UsageError, match="--minutes 0 is out of range"):
        main((tmp_path,), out=tmp_path / "out", table=("baselines",), minutes=0)


@pytest.mark.slow
def test_table_10_encodes_one_reconstruction_in_seven_ways(runs: list, tmp_path: Path) -> None:
    from paper_tables.paper_run import write_table

    text = write_table(bench(tmp_path), "10", 4)
    assert text.startswith("toy. Table 10. Ablation on deformation encoding.")
    assert text.count("\n| #") == 7
    assert len(runs) == 1
