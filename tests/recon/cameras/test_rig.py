import re
from pathlib import Path

import numpy as np
import pytest
import torch

from splatreel.capture.poses import inverted
from splatreel.config import Config
from splatreel.errors import ReconstructionError
from splatreel.recon.cameras.findings import Findings
from splatreel.recon.cameras.rig import Rig
from splatreel.recon.run import checkpoint
from tests.notes import Notes
from tests.recon.cameras.test_poses import apart, turned
from tests.recon.captures import WallCapture
from tests.recon.corner import arc, pictures
from tests.recon.small import plain

CPU = torch.device("cpu")
CONFIG = Config()
CAPTURE = WallCapture(6, speed=0.0, drift=0.1)
CAMERAS = CAPTURE.cameras
NAMES = [camera.name for camera in CAMERAS]
CORNER = arc(9)
PICTURES = np.stack([pictures(CORNER)] * 2)


def test_exposures_go_on_from_group_to_group_and_a_restored_rig_knows_as_much(tmp_path: Path) -> None:
    rig, notes = Rig(CAMERAS, CONFIG, CPU), Notes()
    rig.gains.load(torch.rand(len(NAMES), 3))
    for first, folder in ((0, tmp_path / "a"), (3, tmp_path / "b")):
        folder.mkdir()
        frames = CAPTURE.read(first, min(4, 6 - first), NAMES)
        rig.even_out(frames, 3, folder, notes)
        assert np.abs(frames.astype(float) - CAPTURE.read(0, 1, NAMES)[0]).mean() < 1.5
        rig.delays.load(np.linspace(-0.3, 0.3, len(NAMES)) + first / 150)
        rig.keep_delays(folder, notes)
        checkpoint.save_arrays(folder / "keyframe.safetensors", rig.packed_gains())
        other = Rig(CAMERAS, CONFIG, CPU)
        other.restore(3, folder)
        assert np.array_equal(other.exposure, rig.exposure)
        assert np.array_equal(other.delays.values, rig.delays.values)
        assert torch.equal(other.gains.values, rig.gains.values)
        assert np.array_equal(np.stack(other.ends), rig.delays.values[None])
    assert "exposures change by up to" in notes.lines[0]
    late = [line for line in notes.lines if "out of step" in line]
    assert late[0] == f"cameras are out of step, {NAMES[0]} is 0.30 frames early (give or take 0.00): allowed for"
    assert late[1] == f"cameras are out of step, {NAMES[-1]} is 0.32 frames late (give or take 0.02): allowed for"


def test_delays_that_groups_do_not_agree_on_are_not_told(tmp_path: Path) -> None:
    rig, notes, rng = Rig(CAMERAS, CONFIG, CPU), Notes(), np.random.default_rng(0)
    said = []
    for group in range(4):
        (folder := tmp_path / str(group)).mkdir()
        rig.delays.load(rng.normal(0, 0.15, len(NAMES)))
        rig.keep_delays(folder, notes)
        said.append(len(notes.lines))
    assert said[1:] == [said[0]] * 3


def test_light_is_taken_out_and_goes_on_from_group_to_group(tmp_path: Path) -> None:
    rig, notes = Rig(CAMERAS, CONFIG, CPU), Notes()
    dusk = np.array([1, 0.9, 0.8, 0.7, 0.7, 0.7], np.float32)
    still = np.repeat(CAPTURE.read(0, 1, NAMES), 6, 0)
    frames = np.rint(still * dusk[:, None, None, None, None]).astype(np.uint8)
    for first, folder in ((0, tmp_path / "a"), (3, tmp_path / "b")):
        folder.mkdir()
        light = rig.even_out(own := frames[first : first + 4].copy(), 3, folder, notes)
        assert light is not None
        assert np.abs(light - dusk[first : first + 4, None]).max() < 0.02
        assert np.abs(own.astype(float) - still[0]).mean() < 1.5
        other = Rig(CAMERAS, CONFIG, CPU)
        other.restore(3, folder)
        assert np.array_equal(other.light, rig.light)
    assert [line[:25] for line in notes.lines] == ["the light changes by up t"] * 2


@pytest.mark.parametrize("restored", [False, True])
def test_what_is_off_is_not_written_and_changes_nothing(tmp_path: Path, restored: bool) -> None:
    rig, notes = (
        Rig(CAMERAS, plain(), CPU),
        Notes(),
    )
    frames = CAPTURE.read(0, 6, NAMES)
    before = frames.copy()
    rig.even_out(frames, 3, tmp_path, notes)
    rig.keep_delays(tmp_path, notes)
    if restored:
        rig.restore(3, tmp_path)
    assert np.array_equal(frames, before)
    assert not rig.exposure.any()
    assert not rig.delays.values.any()
    assert not notes.lines
    assert not list(tmp_path.iterdir())


def test_a_camera_that_was_touched_is_put_right_and_a_stranger_left_out(tmp_path: Path) -> None:
    frames = PICTURES.copy()
    frames[:, 6] = frames[:, 6, ::-1, ::-1]
    said = [turned(camera, 1.0) if number == 2 else camera for number, camera in enumerate(CORNER)]
    rig, notes = Rig(said, CONFIG, CPU), Notes()
    kept = rig.gather(frames, tmp_path, notes)
    others = [camera for camera in CORNER if camera.name != "cam6"]
    assert rig.names == [camera.name for camera in others]
    assert np.array_equal(kept, np.delete(frames, 6, 1))
    assert apart(rig.cameras[2], CORNER[2]) < 0.3
    assert len(rig.gains.values) == len(rig.delays.values) == len(rig.exposure) == 8
    assert notes.lines[0].startswith("cam2 is not where its pose says")
    assert notes.lines[1].startswith("cam6 shows nothing that its neighbours do")
    again = Rig(said, CONFIG, CPU)
    again.stand(tmp_path)
    assert again.names == rig.names
    assert np.array_equal(again.cameras[2].viewmat, rig.cameras[2].viewmat)
    rig.place(np.delete(frames, 6, 1), tmp_path, notes)  # the first group, continued: known already
    assert len(notes.lines) == 2


def test_a_camera_that_is_touched_later_is_put_right_from_the_next_group_on(tmp_path: Path) -> None:
    rig, notes = Rig([*CORNER[:4], turned(CORNER[4], 1.0), *CORNER[5:]], CONFIG, CPU), Notes()
    rig.place(PICTURES, tmp_path, notes)
    assert apart(rig.cameras[4], CORNER[4]) < 0.3
    restored = Rig(CORNER, CONFIG, CPU)
    restored.restore(3, tmp_path)
    assert np.array_equal(restored.cameras[4].viewmat, rig.cameras[4].viewmat)
    frames = PICTURES.copy()
    frames[:, 1] = frames[:, 1, ::-1, ::-1]
    rig.place(frames, tmp_path / "next", notes)
    assert notes.lines[1] == "cam1 no longer shows what its neighbours do: check its video"
    assert len(rig.cameras) == 9


def test_poses_the_other_way_round_are_refused(tmp_path: Path) -> None:
    with pytest.raises(
        ReconstructionError, match=r"scene/extri.yml: the poses .* would if they were camera to world\."
    ):
        Rig(inverted(CORNER), CONFIG, CPU).gather(PICTURES, tmp_path, Notes(), "scene/extri.yml")
    assert not list(tmp_path.iterdir())


def test_a_user_is_told_of_poses_that_nobody_can_check(tmp_path: Path) -> None:
    notes = Notes()
    assert len(Rig(CORNER, CONFIG, CPU).gather(np.full_like(PICTURES, 90), tmp_path, notes)[0]) == 9
    assert notes.lines == ["the cameras show too little in common to check their poses: taken as they are said to be"]
    (line,) = Findings({}, [], [], [1]).doubts(["a", "b", "c"])
    assert line == "b: too little in common with the other cameras to check the pose, taken as it is said to be"


def test_where_too_many_are_wrong_the_user_is_told_and_nothing_changes(tmp_path: Path) -> None:
    said = [turned(camera, 1.0) if number % 3 == 1 else camera for number, camera in enumerate(CORNER)]
    rig, notes = Rig(said, CONFIG, CPU), Notes()
    assert np.array_equal(rig.gather(PICTURES, tmp_path, notes), PICTURES)
    assert all(np.array_equal(now.viewmat, before.viewmat) for now, before in zip(rig.cameras, said, strict=True))
    (line,) = notes.lines
    assert re.match("the poses or lenses of .*cam1.*cam4.*cam7.* do not fit each other, too many to be put right", line)
