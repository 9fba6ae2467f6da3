"""The first keyframe is shown while it trains, at times that cost little."""

from pathlib import Path

import pytest

from splatreel.codec.preview import newest_preview
from splatreel.run import groups
from splatreel.run.groups import EVERY, FIRST_AFTER, MAX_SHARE, KeyframePreview
from splatreel.run.store import Store
from splatreel.scene.gaussians import Gaussians
from tests.codec.reels import new_header, points


class Clock:
    now = 50.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = Store(tmp_path / "work")
    store.work.mkdir()
    store.save_header(new_header(), None)
    return store


def unwanted() -> Gaussians:
    raise AssertionError("the points were asked for although no preview is due")


def test_previews_are_written_after_some_seconds_and_then_every_few_seconds(store: Store, tmp_path: Path) -> None:
    clock = Clock()
    preview = KeyframePreview(store, clock)
    preview.show(unwanted)  # training begins
    clock.now += FIRST_AFTER - 0.1
    preview.show(unwanted)
    clock.now += 0.2
    preview.show(lambda: points(20))
    first = newest_preview(tmp_path)
    assert first is not None
    clock.now += EVERY - 0.1
    preview.show(unwanted)
    clock.now += 0.2
    preview.show(lambda: points(20))
    second = newest_preview(tmp_path)
    assert second not in (None, first)
    preview.finish(points(25))
    assert newest_preview(tmp_path) not in (None, second)


def test_slow_previews_are_rarer(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    clock, seconds, written = Clock(), 10.0, list[float]()

    def slow(*_: object) -> Path:
        written.append(clock.now)
        clock.now += seconds
        return store.work

    monkeypatch.setattr(groups, "write_preview", slow)
    preview, begin = KeyframePreview(store, clock), clock.now
    for _ in range(1000):
        clock.now += 1
        preview.show(lambda: points(5))
    assert len(written) >= 2
    assert len(written) * seconds <= 1.1 * MAX_SHARE * (clock.now - begin) + seconds


def test_short_trainings_and_trainings_without_a_reel_have_no_preview(store: Store, tmp_path: Path) -> None:
    clock = Clock()
    preview = KeyframePreview(store, clock)
    preview.finish(points(5))
    assert newest_preview(tmp_path) is None
    (store.work / "header.json").unlink()
    preview.show(unwanted)
    clock.now += 100
    preview.show(lambda: points(5))
    clock.now += 100
    preview.show(unwanted)
    assert newest_preview(tmp_path) is None
