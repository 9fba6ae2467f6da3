"""Stages load a saved result, or compute and save it; a stage that does not apply does nothing."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from splatreel.base.progress import Silent
from splatreel.config import Config
from splatreel.method.cameras.rig import Poses, Rig
from splatreel.method.layering.labels import Layers, RelitPoints
from splatreel.run.checkpoint import Arrays
from splatreel.run.job import Job, Plan
from splatreel.run.stages.camera_stages import load_poses, save_poses
from splatreel.run.stages.group_stages import GROUP_STAGES, restored_rig
from splatreel.run.stages.stage import (
    AfterGap,
    FirstOfChapter,
    FirstOfVideo,
    GroupState,
    NextGroup,
    RetiredStatic,
    Stage,
)
from splatreel.run.store import GroupStore, Store
from splatreel.run.workload import Workload
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.spans import GroupSpan
from splatreel.scene.static_points import StaticPoints
from tests.method.scenes import ring

NONE = StaticPoints.none(0)
RIG = Rig.of(ring(3, width=8, height=8))
NEXT = NextGroup(RIG, NONE, Gaussians.empty(0), None)


class Square(Stage[int]):
    """Computes the square of the group's index, and counts its runs."""

    name = "square"
    text = "squaring"
    checkpoint = "square"
    starts = (NextGroup,)

    def __init__(self) -> None:
        self.runs = 0

    def seconds(self, work: Workload, frames: int, config: Config) -> float:
        return 0.0

    def run(self, state: GroupState) -> int:
        self.runs += 1
        return state.span.index**2

    def apply(self, state: GroupState, found: int) -> None:
        vars(state)["square"] = found

    def pack(self, found: int) -> Arrays:
        return {"square": np.array([found])}

    def unpack(self, arrays: Arrays) -> int:
        return int(arrays["square"][0])


def state_of(tmp_path: Path, start: Any) -> Any:
    """Return a state with the fields that `Stage.execute` uses."""
    store, span = Store(tmp_path), GroupSpan(4, 0, 1, 1)
    job = Job(Config(), torch.device("cpu"), Silent(), store, Plan((("squaring", 4, 1.0),)), groups=5)
    return SimpleNamespace(start=start, job=job, span=span, store=store.group(4))


def test_result_is_computed_once_then_loaded(tmp_path: Path) -> None:
    stage = Square()
    for _ in range(2):
        state = state_of(tmp_path, NEXT)
        stage.execute(state)
        assert state.square == 16
    assert stage.runs == 1
    assert "square" in state.job.seconds


@pytest.mark.parametrize("start", [FirstOfVideo(RIG, NONE), FirstOfChapter(RIG, NONE)])
def test_stage_is_skipped_for_other_starts(tmp_path: Path, start: Any) -> None:
    stage, state = Square(), state_of(tmp_path, start)
    stage.execute(state)
    assert not stage.runs
    assert not hasattr(state, "square")


def test_stage_of_next_group_also_follows_a_gap(tmp_path: Path) -> None:
    stage = Square()
    stage.execute(state_of(tmp_path, AfterGap(RIG, NONE, Gaussians.empty(0), None, np.zeros((3, 8, 8, 3), np.uint8))))
    assert stage.runs == 1


def test_each_start_has_one_keyframe_stage() -> None:
    for start in (FirstOfVideo, FirstOfChapter, NextGroup):
        assert len([stage for stage in GROUP_STAGES if stage.name == "keyframe" and start in stage.starts]) == 1


def test_shown_texts_and_labels_are_distinct_and_complete() -> None:
    texts = [stage.text for stage in GROUP_STAGES if stage.text]
    assert len(set(texts)) == len(texts)
    assert all(stage.name and stage.label for stage in GROUP_STAGES)


def test_restored_rig_drops_left_out_cameras_first(tmp_path: Path) -> None:
    store = GroupStore(tmp_path)
    kept = [RIG.cameras[0], RIG.cameras[2]]
    save_poses(store, Poses(np.stack([camera.viewmat for camera in kept]), np.array([0, 2])))
    store.save("exposure", {"change": np.full((2, 2, 3), 0.5, np.float32), "light": np.zeros((2, 3), np.float32)})
    poses, rig = load_poses(store), restored_rig(RIG, store, 1)
    assert poses is not None
    assert rig.names == [camera.name for camera in kept]
    assert rig.exposure.tolist() == [[0.5] * 3] * 2


def test_retired_static_points_become_new_ones() -> None:
    rng = np.random.default_rng(0)
    trained, settled = points(rng, 3), points(rng, 2)
    retired = RetiredStatic(points(rng, 3), np.ones(3, bool), trained)
    layers = Layers(
        np.array([True, False, True]), settled, Gaussians.empty(0), RelitPoints(Gaussians.empty(0), np.zeros((1, 0)))
    )
    renewed, static = retired.reissue(layers)
    assert np.array_equal(renewed.settled.means, np.concatenate([trained.means[[0, 2]], settled.means]))
    assert len(renewed.alive) == len(static.alive) == len(static.points) == 0
    assert isinstance(retired.with_alive(layers.alive), RetiredStatic)


def points(rng: np.random.Generator, count: int) -> Gaussians:
    """Random Gaussians."""
    quats = np.tile(np.array([1.0, 0, 0, 0], np.float32), (count, 1))
    means, scales = rng.random((count, 3)), rng.random((count, 3))
    return Gaussians(means, quats, scales, rng.random(count), rng.random((count, 1, 3)))
