from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from splatreel.run.costs import facing
from splatreel.run.machine_speed import MachineSpeed
from splatreel.run.machines.estimate import estimate, moving_share
from splatreel.run.machines.scaling import Division
from splatreel.run.memory import needed_memory
from splatreel.scene.camera import Camera
from splatreel.scene.group import chapter_spans, group_spans
from tests.method.captures import WallCapture
from tests.method.small import small


def a_run(frames: int, device: str = "cpu", chapter_frames: int = 300) -> Any:
    """Return a stand-in of a run."""
    config, groups = small({"group.length": 30, "group.overlap": 5}), group_spans(frames, 30, 5)
    return SimpleNamespace(
        capture=WallCapture(frames),
        config=config,
        device_name=device,
        gpu=None,
        groups=groups,
        chapters=chapter_spans(groups, chapter_frames),
    )


def seconds(run: Any, workers: int = 1, threads: int = 1, speed: MachineSpeed = MachineSpeed()) -> float:  # noqa: B008
    return estimate(run, Division(workers, threads), speed, 0.1).total


def test_threads_and_slow_machines() -> None:
    one = seconds(a_run(60))
    assert seconds(a_run(60), threads=2) == pytest.approx(0.64 * one)
    assert 0.4 * one < seconds(a_run(60), threads=4) < 0.5 * one
    assert seconds(a_run(60), speed=MachineSpeed(3.0, 3.0, 3.0)) == pytest.approx(3 * one)


def test_training_speed_depends_on_image_size(monkeypatch: pytest.MonkeyPatch) -> None:
    """Images of more than `Config.training_megapixels` are mostly trained at a smaller size."""
    speed, found = MachineSpeed(2.0, 4.0, 1.0), []
    for megapixels in (0.01, 0.23, 0.7, 4.0):
        for side in ("width", "height"):
            monkeypatch.setattr(WallCapture, side, round(1000 * megapixels**0.5))
        known, slower = (estimate(a_run(60), Division(1, 1), some, 0.1).seconds for some in (MachineSpeed(), speed))
        assert slower["encode"] == known["encode"]
        assert slower["group"] / known["group"] == pytest.approx(slower["keyframe"] / known["keyframe"])
        found.append(slower["group"] / known["group"])
    assert found[0] == pytest.approx(2.0)
    assert 2.0 < found[1] < found[2] < 4.0
    assert found[3] == pytest.approx(found[2], rel=1e-3)


def test_workers_need_less_time_and_more_memory() -> None:
    run = a_run(3000)
    one = estimate(run, Division(1, 4), MachineSpeed(), 0.1)
    four = estimate(run, Division(4, 1), MachineSpeed(), 0.1)
    assert one.total / 2.5 < four.total < one.total
    assert one.memory == needed_memory(run.capture, run.config)
    assert 4 * one.memory < four.memory < 5.5 * one.memory
    assert seconds(a_run(3000), 4) == seconds(a_run(3000), 3) * 3 / 4 or seconds(a_run(3000), 4) < seconds(
        a_run(3000), 3
    )


def test_gpu_training_time_is_independent_of_threads() -> None:
    speed, run = MachineSpeed(0.1, 0.1, 1.0), a_run(60, "cuda")
    cpu = estimate(a_run(60), Division(1, 1), MachineSpeed(), 0.1).seconds
    for threads in (1, 4):
        found = estimate(run, Division(1, threads), speed, 0.1).seconds
        assert found["group"] == pytest.approx(0.1 * cpu["group"])
    chaptered = a_run(3000, "cuda")
    few, many = (estimate(chaptered, Division(1, threads), speed, 0.1).seconds for threads in (1, 8))
    assert few["group"] == pytest.approx(many["group"])
    assert few["tracking"] > 2 * many["tracking"]


def test_moving_share_is_measured_on_few_images() -> None:
    still, quick = moving_share(WallCapture(9, speed=0.0), 9), moving_share(WallCapture(9, speed=0.2), 9)
    assert still == 0
    assert 0.05 < quick < 0.9
    assert moving_share(WallCapture(1), 1) == 0
    estimated = [
        estimate(a_run(30), Division(1, 1), MachineSpeed()),
        estimate(a_run(30), Division(1, 1), MachineSpeed(), 0),
    ]
    assert estimated[0].total > estimated[1].total
    assert estimated[0].moving > 0


def test_cameras_that_look_the_same_way() -> None:
    assert facing(WallCapture(1, cameras=3).cameras) > 0.9
    ahead = np.eye(4)
    back = np.diag([-1.0, 1.0, -1.0, 1.0])
    assert facing([Camera(str(k), view, np.eye(3), 4, 4) for k, view in enumerate((ahead, back))]) == 0
