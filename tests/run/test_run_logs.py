import json
import time
from pathlib import Path

import pytest

from splatreel.base.progress import Silent
from splatreel.run.run_logs import RecordedProgress, RunHistory, read_history


class Clock:
    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        self.now += 1
        return self.now


class Trace(Silent):
    def __init__(self) -> None:
        self.seen: list[tuple] = []

    def stage(self, name: str, total: int, span=None) -> None:
        self.seen.append((name, total, span))

    def update(self, done: int, **numbers: float) -> None:
        self.seen.append((done, numbers))

    def note(self, text: str) -> None:
        self.seen.append((text,))


def record(work: Path, part: str = "", clock: Clock | None = None) -> Trace:
    shown = Trace()
    progress = RecordedProgress(shown, work, part, "cpu", clock or Clock())
    progress.stage("initial points", 1)
    progress.note("cam03 is turned by 1.2 degrees.")
    for group in (1, 2):
        progress.stage(f"group {group}/2: training the keyframe", 1000, (0.0, 0.5))
        for done in range(0, 1001, 10):
            progress.update(done, loss=1 / (done + 1), points=10 * group)
    progress.note("27.0 dB")
    return shown


def test_history_holds_stages_notes_and_samples(tmp_path: Path) -> None:
    shown = record(tmp_path)
    assert len(shown.seen) == 3 + 2 * 102  # the display gets everything
    history = read_history(tmp_path)
    assert [(stage.name, stage.group) for stage in history.stages] == [
        ("initial points", None),
        ("training the keyframe", 0),
        ("training the keyframe", 1),
    ]
    assert history.notes == ["cam03 is turned by 1.2 degrees.", "Group 2: 27.0 dB"]
    assert history.machines[0].endswith(", cpu, Splatreel 0.1.0")
    keyframe = history.stages[2]
    curve = keyframe.curve("loss")
    assert 30 <= len(curve) <= 45
    assert curve[0] == (0.0, 1.0)
    assert curve[-1] == (1.0, 1 / 1001)
    assert dict(keyframe.curve("points"))[1.0] == 20
    assert keyframe.curve("moving") == []
    assert set(history.group_seconds()) == {0, 1}
    assert all(seconds > 30 for seconds in history.group_seconds().values())


def test_continued_runs_and_jobs_are_joined(tmp_path: Path) -> None:
    clock = Clock()
    record(tmp_path, "chapter0000", clock)
    record(tmp_path, "chapter0000", clock)
    record(tmp_path, "chapter0001", clock)
    history = read_history(tmp_path)
    assert len(history.stages) == 9
    assert [stage.begin for stage in history.stages] == sorted(stage.begin for stage in history.stages)
    assert (len(history.notes), len(history.machines)) == (2, 1)


def test_damaged_lines_are_skipped(tmp_path: Path) -> None:
    record(tmp_path)
    path = next((tmp_path / "logs").iterdir())
    whole = read_history(tmp_path)
    with path.open("a") as file:
        file.write('[1]\n{"at": "now"}\n{"at": 1e999, "done": 1}\nnull\n' + json.dumps({"at": 2000.0, "done": 1})[:-4])
    assert read_history(tmp_path) == whole
    assert read_history(tmp_path / "nothing") == RunHistory()


def test_a_full_disk_does_not_stop_a_run(tmp_path: Path) -> None:
    (tmp_path / "logs").write_text("a file where the folder should be")
    assert len(record(tmp_path).seen) == 207


def test_clock_that_is_set_back_makes_no_negative_duration(tmp_path: Path) -> None:
    times = iter([2000.0, 2000.0, 500.0, 501.0])
    progress = RecordedProgress(Silent(), tmp_path, "", "cpu", lambda: next(times))
    progress.stage("group 1/1: training the keyframe", 1)
    progress.update(1)
    assert [stage.seconds for stage in read_history(tmp_path).stages] == [0.0]
    assert read_history(tmp_path).group_seconds() == {0: 0.0}


def test_clock_that_is_set_while_a_run_goes_on_does_not_change_its_times(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = time.time()
    progress = RecordedProgress(Silent(), tmp_path, "", "cpu")
    progress.stage("preparing", 1)
    monkeypatch.setattr(time, "time", lambda: now - 1e9)
    progress.update(1)
    (stage,) = read_history(tmp_path).stages
    assert stage.end >= stage.begin >= now - 1
