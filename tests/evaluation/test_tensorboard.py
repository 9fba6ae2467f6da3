import struct
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from splatreel.base.errors import MissingDependencyError, UsageError
from splatreel.base.progress import Silent
from splatreel.codec.reader import ReelReader
from splatreel.evaluation.page.report_writer import ReportWriter
from splatreel.evaluation.tensorboard import STEPS_PER_GROUP, EventWriter, check_tensorboard
from splatreel.run.run_history import RecordedProgress
from tests.evaluation import scenes

pytest.importorskip("tensorboardX")


def read_events(out: Path) -> dict[str, dict[int, float]]:
    """Return the scalars of all event files, by tag and step. A file is a list of records: length, checksum, event, checksum."""
    from tensorboardX.proto.event_pb2 import Event  # pyright: ignore[reportAttributeAccessIssue]

    found: dict[str, dict[int, float]] = {}
    for path in (out / "tensorboard").glob("events.out.tfevents.*"):
        data, place = path.read_bytes(), 0
        while place < len(data):
            (length,) = struct.unpack_from("<Q", data, place)
            event = Event.FromString(data[place + 12 : place + 12 + length])
            place += 16 + length
            for value in event.summary.value:
                assert event.step not in found.setdefault(value.tag, {}), "each number is written once"
                found[value.tag][event.step] = value.simple_value
    return found


def train(out: Path, clock: list[float]) -> None:
    """Record a group as a run does: a keyframe, then the motion."""
    progress = RecordedProgress(Silent(), out / "work", "", "cpu", lambda: clock[0])
    for stage, loss in (("training the keyframe", 0.5), ("training the motion", 0.25)):
        progress.stage(f"group 1/1: {stage}", 100)
        for done in (50, 100):
            clock[0] += 10.0
            progress.update(done, loss=loss / done)
    progress.update(100, psnr=31.5)
    progress.stage("writing", 1)


@pytest.fixture
def hooks(tmp_path: Path) -> tuple[Path, list[int | None], Any]:
    out, calls = scenes.write_run(tmp_path), []
    report = ReportWriter(out, lambda _, group: calls.append(group), Silent())
    return out, calls, EventWriter(out, report)


def test_events_hold_the_numbers_of_each_group(hooks) -> None:
    out, calls, events = hooks
    writer: Any = SimpleNamespace(manifest=ReelReader(out / "reel").manifest)
    train(out, [1000.0])
    events(writer, 0)
    early = read_events(out)
    assert set(early) == {"loss/training_the_keyframe", "loss/training_the_motion"}, "the newest group is not finished"
    assert early["loss/training_the_motion"] == pytest.approx({STEPS_PER_GROUP // 2: 0.005, STEPS_PER_GROUP: 0.0025})
    events(writer, None)
    events.finish()
    found = {tag.removeprefix("group/"): steps for tag, steps in read_events(out).items() if tag.startswith("group/")}
    size = sum((out / "reel" / entry.uri).stat().st_size for entry in writer.manifest.files)
    assert found == {
        "loss": {1: pytest.approx(0.0025)},
        "training_psnr": {1: 31.5},
        "static_points": {1: 100},
        "dynamic_points": {1: 200},
        "bytes": {1: size},
        "seconds": {1: 40},
    }
    assert calls == [0, None]
    assert (out / "report.html").exists()


def test_a_continued_run_replaces_the_events(hooks) -> None:
    out, _, events = hooks
    train(out, [1000.0])
    events.finish()
    before = read_events(out)
    again = EventWriter(out, ReportWriter(out, lambda *_: None, Silent()))
    again.finish()
    assert read_events(out) == before


def test_a_job_that_writes_no_groups_leaves_the_events(tmp_path: Path) -> None:
    EventWriter(tmp_path, ReportWriter(tmp_path, lambda *_: None, Silent())).finish()
    assert list(tmp_path.iterdir()) == []


def test_missing_package_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(__import__("sys").modules, "tensorboardX", None)
    with pytest.raises(MissingDependencyError, match=r"--tensorboard needs tensorboardX.*splatreel\[tensorboard\]"):
        check_tensorboard(str(tmp_path))


def test_addresses_are_refused() -> None:
    with pytest.raises(UsageError, match=r"--tensorboard writes to OUT/tensorboard, but s3://bucket/out"):
        check_tensorboard("s3://bucket/out")
