import importlib
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from splatreel.base.errors import UsageError
from splatreel.base.progress import Progress, Silent
from splatreel.method.train.group_trainer import GroupTrainer
from splatreel.method.train.keyframe_trainer import KeyframeTrainer
from tests.method.captures import WallCapture
from tests.method.small import small

FRAMES = 4
ROUNDED = 0.03
"""Seconds that times may be off by, each being rounded to hundredths."""


@pytest.fixture
def curve(benchmarks: Path) -> ModuleType:
    return importlib.import_module("curve")


@pytest.fixture
def reconstructed(curve: ModuleType, tmp_path: Path) -> Callable[[Progress], dict[str, Any]]:
    """A function that reconstructs within a thousand seconds, and gives what was found."""

    def run(shown: Progress) -> dict[str, Any]:
        capture, found = WallCapture(FRAMES), {}
        capture.held_out = ["cam00"]
        trains = KeyframeTrainer.train, GroupTrainer.train
        curve.reconstruct_until(found, capture, tmp_path, small(), "cpu", 1000, shown)
        assert (KeyframeTrainer.train, GroupTrainer.train) == trains
        return found

    return run


@pytest.mark.slow
def test_a_run_that_is_let_finish_has_points_of_every_group(
    reconstructed: Callable[[Progress], dict[str, Any]],
) -> None:
    found = reconstructed(Silent())
    learning = [stage for stage in found["stages"] if "training the motion" in stage["stage"]]
    at = [seconds for seconds, _ in found["psnr_at"]]
    assert found["finished"]
    assert len(learning) == 2
    for stage in learning:
        end = stage["begin"] + stage["seconds"]
        assert [s for s in at if stage["begin"] - ROUNDED < s < end + ROUNDED]
    assert at == sorted(at)
    assert found["psnr_at"][-1][1] == pytest.approx(found["psnr"], abs=1)
    assert found["seconds_a_frame"] == pytest.approx(found["seconds"] / FRAMES, abs=ROUNDED / FRAMES)


def test_a_run_whose_time_is_over_stops_and_says_how_far_it_came(
    curve: ModuleType, reconstructed: Callable[[Progress], dict[str, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    class Late(Silent):
        """The first numbers of a training come when its time is over."""

        passed = 0.0

        def update(self, done: int, **numbers: float) -> None:
            self.passed = 2000.0 if "loss" in numbers else 0.0

    late = Late()
    monkeypatch.setattr(curve, "time", SimpleNamespace(monotonic=lambda: time.monotonic() + late.passed))
    found = reconstructed(late)
    assert not found["finished"]
    assert "psnr" not in found
    assert 0 < found["stages"][-1]["done"] < found["stages"][-1]["of"]
    assert len(found["psnr_at"]) == 1
    assert found["seconds_a_frame_expected"] > found["seconds"] / FRAMES


def test_a_curve_needs_a_camera_that_is_held_out(curve: ModuleType, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no camera is held out"):
        curve.reconstruct_until({}, WallCapture(FRAMES), tmp_path, small(), "cpu", 9, Silent())
