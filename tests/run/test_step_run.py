"""Steps load a saved result, or compute, save, write and report it."""

from pathlib import Path

import numpy as np

from splatreel.config import Config
from splatreel.method.cameras.rig import Poses, Rig
from splatreel.method.train.keyframe_trainer import KeyframeResult
from splatreel.run.job import Job, Plan
from splatreel.run.step_checkpoints import POSES, restored_rig
from splatreel.run.step_run import StepRun
from splatreel.run.steps import STEPS
from splatreel.run.store import GroupStore, Store
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import GroupSpan
from tests.method.scenes import ring
from tests.run.test_pipeline import Trace

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
