import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import ReconstructionError
from splatreel.capture.pose_checks import inverted
from splatreel.method.cameras.exposure import at_next_keyframe, measure_exposure, remove_exposure, report_exposure
from splatreel.method.cameras.poses import PoseFindings
from splatreel.method.cameras.rig import Rig, check_first_poses, check_later_poses, report_offsets
from splatreel.method.cameras.time_offsets import LearnedOffsets
from splatreel.method.train.keyframe_trainer import KeyframeResult
from splatreel.run.steps import EXPOSURE, KEYFRAME, POSES, restored_rig
from splatreel.run.store import GroupStore
from splatreel.scene.gaussians import Gaussians
from tests.method.cameras.test_poses import apart, turned
from tests.method.captures import WallCapture
from tests.method.corner import arc, make_images
from tests.notes import Notes

CAPTURE = WallCapture(6, speed=0.0, drift=0.1)
CAMERAS = CAPTURE.cameras
NAMES = [camera.name for camera in CAMERAS]
CORNER = arc(9)
IMAGES = np.stack([make_images(CORNER)] * 2)


def test_exposures_carry_over_and_restored_rig_is_equal(tmp_path: Path) -> None:
    notes = Notes()
    rig = again = replace(Rig.of(CAMERAS), gains=np.random.default_rng(0).random((len(NAMES), 3), np.float32))
    for first, store in ((0, GroupStore(tmp_path / "a")), (3, GroupStore(tmp_path / "b"))):
        frames = CAPTURE.read(first, min(4, 6 - first), NAMES)
        EXPOSURE.save(store, exposure := measure_exposure(rig, frames))
        report_exposure(rig, exposure, notes)
        remove_exposure(frames, exposure)
        assert np.abs(frames.astype(float) - CAPTURE.read(0, 1, NAMES)[0]).mean() < 1.5
        learned = LearnedOffsets(np.linspace(-0.3, 0.3, len(NAMES)) + first / 150, 0.0)
        rig = at_next_keyframe(rig, exposure, 3).with_offsets(learned.values)
        store.save("delays", {"delays": learned.values})
        report_offsets(rig, learned, notes)
        KEYFRAME.save(store, KeyframeResult(Gaussians.empty(), rig.gains))
        again = restored_rig(again, store, 3)
        assert np.array_equal(again.exposure, rig.exposure)
        assert np.array_equal(again.time_offsets, rig.time_offsets)
        assert np.array_equal(again.gains, rig.gains)
        assert np.array_equal(np.stack(again.ends), np.stack(rig.ends))
    assert "exposures change by up to" in notes.lines[0]
    late = [line for line in notes.lines if "out of step" in line]
    assert late[0] == f"cameras are out of step, {NAMES[0]} is 0.30 frames early (uncertainty 0.00): corrected"
    assert late[1] == f"cameras are out of step, {NAMES[-1]} is 0.32 frames late (uncertainty 0.02): corrected"


def test_inconsistent_time_offsets_are_not_reported() -> None:
    rig, notes, rng = Rig.of(CAMERAS), Notes(), np.random.default_rng(0)
    said = []
    for _ in range(4):
        offsets = rng.normal(0, 0.15, len(NAMES))
        rig = rig.with_offsets(offsets)
        report_offsets(rig, LearnedOffsets(offsets, 0.0), notes)
        said.append(len(notes.lines))
    assert said[1:] == [said[0]] * 3


def test_light_is_removed_and_carries_over(tmp_path: Path) -> None:
    rig, notes = Rig.of(CAMERAS), Notes()
    dusk = np.array([1, 0.9, 0.8, 0.7, 0.7, 0.7], np.float32)
    still = np.repeat(CAPTURE.read(0, 1, NAMES), 6, 0)
    frames = np.rint(still * dusk[:, None, None, None, None]).astype(np.uint8)
    for first, store in ((0, GroupStore(tmp_path / "a")), (3, GroupStore(tmp_path / "b"))):
        own = frames[first : first + 4].copy()
        EXPOSURE.save(store, exposure := measure_exposure(rig, own))
        report_exposure(rig, exposure, notes)
        remove_exposure(own, exposure)
        light, rig = exposure.light_factors, at_next_keyframe(rig, exposure, 3)
        assert light is not None
        assert np.abs(light - dusk[first : first + 4, None]).max() < 0.02
        assert np.abs(own.astype(float) - still[0]).mean() < 1.5
        assert np.array_equal(restored_rig(Rig.of(CAMERAS), store, 3).light, rig.light)
    assert [line[:25] for line in notes.lines] == ["the light changes by up t"] * 2


def test_rig_without_checkpoints_stays(tmp_path: Path) -> None:
    rig = Rig.of(CAMERAS)
    assert restored_rig(rig, GroupStore(tmp_path), 3) == rig
    assert not rig.exposure.any()
    assert not rig.time_offsets.any()
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_moved_camera_is_corrected_and_stranger_left_out(tmp_path: Path) -> None:
    frames = IMAGES.copy()
    frames[:, 6] = frames[:, 6, ::-1, ::-1]
    said = [turned(camera, 1.0) if number == 2 else camera for number, camera in enumerate(CORNER)]
    notes, store = Notes(), GroupStore(tmp_path)
    POSES.save(store, poses := check_first_poses(Rig.of(said), frames, "The capture", notes))
    rig = Rig.of(said).with_poses(poses)
    others = [camera for camera in CORNER if camera.name != "cam6"]
    assert rig.names == [camera.name for camera in others]
    assert np.array_equal(frames[:, poses.kept], np.delete(frames, 6, 1))
    assert apart(rig.cameras[2], CORNER[2]) < 0.3
    assert len(rig.gains) == len(rig.time_offsets) == len(rig.exposure) == 8
    assert notes.lines[0].startswith("cam2 was moved after its calibration")
    assert notes.lines[1].startswith("cam6 does not show at its pose what its neighbors show")
    again = restored_rig(Rig.of(said), store, 3)
    assert again.names == rig.names
    assert np.array_equal(again.cameras[2].viewmat, rig.cameras[2].viewmat)
    assert restored_rig(again, store, 3).names == rig.names  # the first group, continued: they are left out already


@pytest.mark.slow
def test_camera_moved_later_is_corrected_in_the_next_group(tmp_path: Path) -> None:
    rig, notes, store = Rig.of([*CORNER[:4], turned(CORNER[4], 1.0), *CORNER[5:]]), Notes(), GroupStore(tmp_path)
    POSES.save(store, poses := check_later_poses(rig, IMAGES, notes))
    rig = rig.with_poses(poses)
    assert apart(rig.cameras[4], CORNER[4]) < 0.3
    restored = restored_rig(Rig.of(CORNER), store, 3)
    assert np.array_equal(restored.cameras[4].viewmat, rig.cameras[4].viewmat)
    frames = IMAGES.copy()
    frames[:, 1] = frames[:, 1, ::-1, ::-1]
    rig = rig.with_poses(check_later_poses(rig, frames, notes))
    assert notes.lines[1] == "cam1 no longer shows what its neighbors show: check its video"
    assert len(rig.cameras) == 9


def test_camera_to_world_poses_are_refused() -> None:
    with pytest.raises(
        ReconstructionError, match=r"scene/extri.yml: the poses .* would if they were camera to world\."
    ):
        check_first_poses(Rig.of(inverted(CORNER)), IMAGES, "scene/extri.yml", Notes())


def test_unverifiable_poses_are_reported() -> None:
    notes = Notes()
    poses = check_first_poses(Rig.of(CORNER), np.full_like(IMAGES, 90), "The capture", notes)
    assert len(Rig.of(CORNER).with_poses(poses).cameras) == 9
    assert notes.lines == ["the cameras show too little in common to check their poses: they are used unchecked"]
    (line,) = PoseFindings({}, [], [], [1]).doubts(["a", "b", "c"])
    assert line == "b: too little in common with the other cameras to check the pose, which is used unchecked"


def test_too_many_wrong_poses_are_reported_and_kept() -> None:
    said = [turned(camera, 1.0) if number % 3 == 1 else camera for number, camera in enumerate(CORNER)]
    notes = Notes()
    rig = Rig.of(said).with_poses(check_first_poses(Rig.of(said), IMAGES, "The capture", notes))
    assert all(np.array_equal(now.viewmat, before.viewmat) for now, before in zip(rig.cameras, said, strict=True))
    (line,) = notes.lines
    assert re.match("the poses or lenses of .*cam1.*cam4.*cam7.* do not fit each other, too many to be corrected", line)
