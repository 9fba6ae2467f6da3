import struct
from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("tensorboardX")

import tensorboard_events
from splatreel.base.progress import Silent
from splatreel.codec.reader import ReelReader
from splatreel.run.run_logs import RecordedProgress
from tensorboard_events import STEPS_PER_GROUP, EventWriter
from tests.evaluation import scenes


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


@pytest.mark.parametrize("live", [True, False])
def test_events_hold_the_numbers_of_each_finished_group(
    live: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = scenes.write_run(tmp_path)
    manifest = replace(ReelReader(out / "reel").manifest, live=live)
    monkeypatch.setattr(tensorboard_events, "read_written_manifest", lambda _: manifest)
    train(out, [1000.0])
    events = EventWriter(out)
    assert events.write() != live
    assert events.write() != live
    events.close()
    found = read_events(out)
    assert found["loss/training_the_motion"] == pytest.approx({STEPS_PER_GROUP // 2: 0.005, STEPS_PER_GROUP: 0.0025})
    groups = {tag.removeprefix("group/"): steps for tag, steps in found.items() if tag.startswith("group/")}
    size = sum((out / "reel" / entry.uri).stat().st_size for entry in manifest.files)
    assert groups == (
        {}  # the newest group is not finished
        if live
        else {
            "loss": {1: pytest.approx(0.0025)},
            "training_psnr": {1: 31.5},
            "static_points": {1: 100},
            "dynamic_points": {1: 200},
            "bytes": {1: size},
            "seconds": {1: 40},
        }
    )


def test_events_are_written_anew(tmp_path: Path) -> None:
    out = scenes.write_run(tmp_path)
    train(out, [1000.0])
    tensorboard_events.main(out)
    before = read_events(out)
    tensorboard_events.main(out, every=0.01)
    assert read_events(out) == before


def test_a_run_without_groups_has_no_events(tmp_path: Path) -> None:
    tensorboard_events.main(tmp_path)
    assert list(tmp_path.iterdir()) == []
