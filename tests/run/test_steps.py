"""Files of the steps of a group: their names, the names of their arrays, and round trips. Runs of earlier revisions have these."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from splatreel.config import Config
from splatreel.method.cameras.exposure import Exposure
from splatreel.method.cameras.rig import Poses, Rig
from splatreel.method.layering.labels import Layers, RelitPoints
from splatreel.method.tracking.tracking import GroupStart
from splatreel.method.train.keyframe_trainer import KeyframeResult
from splatreel.run.job import Job, Plan, StepRun
from splatreel.run.steps import (
    CHAPTER,
    EXPOSURE,
    KEYFRAME,
    LAYERS,
    POSES,
    STEPS,
    TIME_OFFSETS,
    TRACKS,
    StepCheckpoint,
    restored_rig,
)
from splatreel.run.store import FIELDS, GroupStore, Store
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import GroupSpan
from tests.method.scenes import ring
from tests.method.test_algorithm import points
from tests.run.test_pipeline import Trace

RNG = np.random.default_rng(0)
POINTS = points(RNG, 4)
ARRAY = RNG.random((2, 4, 3), np.float32)
ALIVE = np.array([True, False])
KINDS = [f"{kind}_{name}" for kind in ("settled", "dynamic", "relit") for name in FIELDS]
CASES: dict[str, tuple[StepCheckpoint[Any], Any, list[str]]] = {
    "exposure": (EXPOSURE, Exposure(ARRAY, ARRAY[0]), ["change", "light"]),
    "poses": (POSES, Poses(np.eye(4)[None], np.array([1])), ["viewmats", "kept"]),
    "keyframe": (KEYFRAME, KeyframeResult(POINTS, ARRAY[0]), [*FIELDS, "gains"]),
    "chapter": (CHAPTER, KeyframeResult(POINTS, ARRAY[0], ALIVE), [*FIELDS, "gains", "alive"]),
    "layering": (LAYERS, Layers(ALIVE, POINTS, POINTS, RelitPoints(POINTS, ARRAY[0])), ["alive", "light", *KINDS]),
    "tracking": (TRACKS, GroupStart(POINTS, ARRAY, ARRAY, ALIVE), [*FIELDS, "tracks", "shades", "left"]),
    "delays": (TIME_OFFSETS, ARRAY[0, :, 0], ["delays"]),
}


@pytest.mark.parametrize("name", CASES)
def test_arrays_of_checkpoint_keep_their_names(name: str, tmp_path: Path) -> None:
    checkpoint, found, names = CASES[name]
    store = GroupStore(tmp_path)
    assert checkpoint.load(store) is None
    checkpoint.save(store, found)
    arrays = store.load(name)
    assert arrays is not None
    assert set(arrays) == set(names)
    assert_equal(checkpoint.load(store), found)


def assert_equal(value: Any, expected: Any) -> None:
    """Compare results field by field."""
    if is_dataclass(expected):
        for field in fields(expected):
            assert_equal(getattr(value, field.name), getattr(expected, field.name))
    else:
        np.testing.assert_array_equal(value, expected)


RIG = Rig.of(ring(3, width=8, height=8))
SPAN = GroupSpan(4, 0, 1, 1)


class Keyframe:
    """Step that counts its calls."""

    def __init__(self) -> None:
        self.calls = 0

    def __call__(self, gain: float) -> KeyframeResult:
        self.calls += 1
        return KeyframeResult(Gaussians.empty(0), np.full((3, 3), gain, np.float32), np.ones(2, bool))


def job_of(tmp_path: Path, trace: Trace) -> Job:
    plan = Plan((("chapter keyframe", 4, 1.0), ("motion", 4, 3.0)))
    return Job(Config(), trace, Store(tmp_path), plan, groups=5)


def test_result_is_computed_and_shown_once_then_loaded(tmp_path: Path) -> None:
    keyframe, trace = Keyframe(), Trace()
    for _ in range(2):
        job = job_of(tmp_path, trace)
        found = StepRun(job, job.store.group(4), SPAN)("chapter keyframe", keyframe, 0.5)
        assert found.gains.tolist() == [[0.5] * 3] * 3
        assert found.alive is not None
        assert found.alive.tolist() == [1, 1]
        assert set(job.seconds) == {"keyframe"}
    assert keyframe.calls == 1
    steps = STEPS["chapter keyframe"].steps(Config(), 1)
    assert trace.stages == [("group 5/5: training the first keyframe of the chapter", steps, (0.0, 0.25))]
    assert list(trace.done.values()) == [steps]


def test_step_without_checkpoint_is_always_computed_and_written(tmp_path: Path) -> None:
    written, keyframe = list[KeyframeResult](), Keyframe()
    for _ in range(2):
        job = job_of(tmp_path, Trace())
        run = StepRun(job, job.store.group(4), SPAN, {"even exposures": written.append})
        assert run("even exposures", keyframe, 0.5) is written[-1]
    assert keyframe.calls == len(written) == 2
    assert not list(tmp_path.glob("group*"))


def test_restored_rig_drops_left_out_cameras_first(tmp_path: Path) -> None:
    store = GroupStore(tmp_path)
    kept = [RIG.cameras[0], RIG.cameras[2]]
    POSES.save(store, Poses(np.stack([camera.viewmat for camera in kept]), np.array([0, 2])))
    store.save("exposure", {"change": np.full((2, 2, 3), 0.5, np.float32), "light": np.zeros((2, 3), np.float32)})
    rig = restored_rig(RIG, store, 1)
    assert rig.names == [camera.name for camera in kept]
    assert rig.exposure.tolist() == [[0.5] * 3] * 2


def test_shown_texts_are_distinct() -> None:
    texts = [step.text for step in STEPS.values() if step.text]
    assert len(set(texts)) == len(texts)
