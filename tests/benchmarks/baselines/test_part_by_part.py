from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from baselines.frame_methods import PerFrame
from baselines.part_by_part import Frames, run_in_parts
from baselines.shared_start import SharedStart
from splatreel.base.errors import UsageError
from splatreel.base.progress import Silent
from splatreel.codec.reader import ReelReader
from splatreel.method.train.training_images import TrainingImages
from splatreel.scene.gaussians import Gaussians
from tests.benchmarks.baselines.starts import SECONDS, write_start
from tests.evaluation import scenes

TOTAL = sum(SECONDS.values())


class Clock:
    """Clock that only training advances, by 0.2 seconds per iteration."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


class Sliding(PerFrame):
    """Method that shifts all points by 0.01 a frame, and fails at a frame."""

    def __init__(self, clock: Clock, fails_at: int | None = None) -> None:
        self.clock, self.fails_at = clock, fails_at
        self.trained: list[int] = []

    def train(
        self, start: SharedStart, before: Gaussians, images: Sequence[TrainingImages], iterations: int, first: int
    ) -> list[Gaussians]:
        if first == self.fails_at:
            raise KeyboardInterrupt
        assert [shown.pixels.shape[:2] for shown in images] == [(1, 3)]
        self.trained.append(first)
        self.clock.now += 0.2 * iterations
        return [replace(before, means=before.means + 0.01)]


@pytest.fixture
def start(tmp_path: Path) -> SharedStart:
    return write_start(scenes.capture(tmp_path), tmp_path / "run")


def test_training_takes_the_time_that_is_left_of_ours(start: SharedStart, tmp_path: Path) -> None:
    method = Sliding(clock := Clock())
    seconds = run_in_parts(method, start, tmp_path / "out", TOTAL, Silent(), clock)
    assert method.trained == [1, 2, 3, 4]
    assert seconds == {"first keyframe": 10.0, "training": pytest.approx(90, abs=0.3)}
    assert sum(seconds.values()) <= TOTAL


def test_reel_has_every_frame(start: SharedStart, tmp_path: Path) -> None:
    run_in_parts(Sliding(clock := Clock()), start, out := tmp_path / "out", TOTAL, Silent(), clock)
    reader = ReelReader(out / "reel")
    assert reader.frames == scenes.FRAMES
    assert not (out / "frames").exists()
    before = reader.static(0)[0].means.mean(0)
    assert reader.static(4)[0].means.mean(0) - before == pytest.approx([0.04] * 3, abs=2e-3)


def test_interrupted_training_continues(start: SharedStart, tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        run_in_parts(Sliding(Clock(), 3), start, tmp_path / "a", TOTAL, Silent(), Clock())
    method = Sliding(Clock())
    run_in_parts(method, start, tmp_path / "a", TOTAL, Silent(), Clock())
    assert method.trained == [3, 4]
    run_in_parts(Sliding(Clock()), start, tmp_path / "b", TOTAL, Silent(), Clock())
    files = [sorted(p.relative_to(tmp_path / k) for p in (tmp_path / k / "reel").rglob("*.safe*")) for k in "ab"]
    assert files[0] == files[1]
    assert all((tmp_path / "a" / f).read_bytes() == (tmp_path / "b" / f).read_bytes() for f in files[0])


def test_a_finished_baseline_is_not_trained_again(start: SharedStart, tmp_path: Path) -> None:
    first = run_in_parts(Sliding(clock := Clock()), start, tmp_path / "out", TOTAL, Silent(), clock)
    method = Sliding(Clock())
    assert run_in_parts(method, start, tmp_path / "out", TOTAL, Silent(), Clock()) == first
    assert method.trained == []


def test_too_little_time_is_refused(start: SharedStart, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"0\.0 minutes do not suffice: our first keyframe"):
        run_in_parts(Sliding(Clock()), start, tmp_path / "out", 1.0, Silent(), Clock())


def test_frames_keep_their_points(tmp_path: Path) -> None:
    frames = Frames(tmp_path, 3)
    frames.save(1, scenes.truth(1))
    assert (frames.load(1).means == scenes.truth(1).means).all()
