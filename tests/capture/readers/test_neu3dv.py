import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatreel.base.errors import CaptureError
from splatreel.capture.opening import open_capture
from tests.capture import folders


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return folders.neu3dv(tmp_path_factory.mktemp("neu3dv") / "scene")


@pytest.fixture
def scene(made: Path, tmp_path: Path) -> Path:
    """Return a copy for modification."""
    return shutil.copytree(made, tmp_path / "scene")


def test_neu3dv_cameras_round_trip(made: Path) -> None:
    capture = open_capture(made)
    for found, written in zip(capture.cameras, folders.cameras(), strict=True):
        assert found.name == written.name
        np.testing.assert_allclose(found.viewmat, written.viewmat, atol=1e-6)
        np.testing.assert_allclose(found.K, written.K, atol=1e-5)


def test_near_bound_and_frame_rate_are_read(made: Path) -> None:
    capture = open_capture(made)
    assert (capture.frames, capture.fps, capture.near, capture.held_out) == (folders.FRAMES, 30.0, 1.5, ["cam00"])
    assert [c.name for c in capture.training_cameras] == ["cam01", "cam02", "cam03"]


def test_read_uses_range_and_camera_order(made: Path) -> None:
    capture = open_capture(made, frames=(3, 11))
    images = capture.read(2, 4, ["cam02", "cam00"])
    assert images.shape == (4, 2, folders.HEIGHT, folders.WIDTH, 3)
    assert [[folders.which(image) for image in step] for step in images] == [[(2, t), (0, t)] for t in range(5, 9)]


def test_resizing_scales_cameras(made: Path) -> None:
    capture = open_capture(made, scale=0.5)
    assert (capture.width, capture.height) == (16, 12)
    np.testing.assert_allclose(capture.camera("cam01").K[0], [20, 0, 8], atol=1e-5)
    assert capture.read(0, 1, ["cam01"]).shape == (1, 1, 12, 16, 3)


def test_poses_of_another_size_are_scaled(scene: Path) -> None:
    poses = np.load(scene / "poses_bounds.npy")
    poses[:, [4, 9, 14]] *= 2
    np.save(scene / "poses_bounds.npy", poses)
    np.testing.assert_allclose(open_capture(scene).cameras[0].K, folders.cameras()[0].K, atol=1e-5)


def test_sidecar_sets_held_out_cameras(scene: Path) -> None:
    (scene / "splatreel.json").write_text(json.dumps({"held_out": ["cam02"], "fps": 25}))
    assert open_capture(scene).held_out == ["cam02"]
    assert open_capture(scene).fps == 25
    assert open_capture(scene, held_out=[]).held_out == []


NOTES = [
    "[]",
    "{",
    '{"held_out": "cam00"}',
    '{"fps": -1}',
    '{"fps": null}',
    '{"transfer": "log"}',
    '{"transfer": ["hlg"]}',
    f'{{"fps": {"9" * 400}}}',
    f'{{"fps": {"9" * 5000}}}',
]


@pytest.mark.parametrize("content", NOTES)
def test_invalid_sidecar_is_named(scene: Path, content: str) -> None:
    (scene / "splatreel.json").write_text(content)
    with pytest.raises(CaptureError, match=r"splatreel\.json"):
        open_capture(scene)


def test_missing_video_is_reported(scene: Path) -> None:
    (scene / "cam02.mp4").unlink()
    with pytest.raises(CaptureError, match=r"3 videos .* but 4 rows in poses_bounds\.npy.* add the missing videos"):
        open_capture(scene)


def test_extra_video_is_reported(scene: Path) -> None:
    shutil.copy(scene / "cam02.mp4", scene / "cam09.mp4")
    with pytest.raises(CaptureError, match=r"5 videos .* but 4 rows"):
        open_capture(scene)


def test_missing_poses_are_reported(scene: Path) -> None:
    (scene / "poses_bounds.npy").unlink()
    with pytest.raises(CaptureError, match=r"poses_bounds\.npy: is missing"):
        open_capture(scene)


def test_unequal_frame_counts_name_the_remedy(scene: Path) -> None:
    folders.write_video(scene / "cam03.mp4", [folders.frame(3, t) for t in range(9)])
    with pytest.raises(CaptureError, match=r"cam03\.mp4 has 9, cam00\.mp4 has 12.*--frames 0:9"):
        open_capture(scene)
    assert open_capture(scene, frames=(0, 9)).frames == 9
    with pytest.raises(CaptureError, match="frames 0:13 were asked for, the capture has frames 0:12"):
        open_capture(scene, frames=(0, 13))
    capture = open_capture(scene, frames=(0, 12))
    assert capture.missing(8, 4, ["cam02", "cam03"]).tolist() == [[False, n > 0] for n in range(4)]
    assert "cam03 has no frames 9-11" in capture.notes[0]


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_nonfinite_poses_name_the_camera(scene: Path, value: float) -> None:
    poses = np.load(scene / "poses_bounds.npy")
    poses[2, 3] = value
    np.save(scene / "poses_bounds.npy", poses)
    with pytest.raises(CaptureError, match=r"poses_bounds\.npy: row 2 .*NaN or infinity"):
        open_capture(scene)


@pytest.mark.parametrize(
    "poses", [np.zeros((4, 15)), np.zeros((4, 3, 5)), np.zeros(17), np.zeros((4, 17), complex), np.full((4, 17), "a")]
)
def test_poses_of_wrong_shape_are_refused(scene: Path, poses: np.ndarray) -> None:
    np.save(scene / "poses_bounds.npy", poses)
    with pytest.raises(
        CaptureError, match=r"poses_bounds\.npy: (has shape .* expected \[cameras, 17\]|is of .* numbers)"
    ):
        open_capture(scene)


def test_invalid_pose_file_is_named(scene: Path) -> None:
    np.save(scene / "poses_bounds.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(CaptureError, match=r"poses_bounds\.npy: is of object, expected an array of plain numbers"):
        open_capture(scene)


def test_pose_without_rotation_is_refused(scene: Path) -> None:
    poses = np.load(scene / "poses_bounds.npy")
    poses[1, :15] = 3.0
    np.save(scene / "poses_bounds.npy", poses)
    with pytest.raises(CaptureError, match=r"row of cam01: its pose .* no rotation"):
        open_capture(scene)


def test_poses_for_another_aspect_ratio_are_refused(scene: Path) -> None:
    poses = np.load(scene / "poses_bounds.npy")
    poses[:, 4] *= 1.5
    np.save(scene / "poses_bounds.npy", poses)
    with pytest.raises(CaptureError, match=r"camera cam00 is calibrated for 32x36, but its images are 32x24, another"):
        open_capture(scene)


def test_videos_of_another_size_are_resized(scene: Path) -> None:
    folders.write_video(scene / "cam01.mp4", [folders.frame(1, t, 64, 48) for t in range(folders.FRAMES)])
    capture = open_capture(scene)
    assert {(camera.width, camera.height) for camera in capture.cameras} == {(32, 24)}
    np.testing.assert_allclose(capture.camera("cam01").K, capture.camera("cam02").K, rtol=1e-5)
    assert folders.which(capture.read(7, 1, ["cam01"])[0, 0]) == (1, 7)


def test_two_cameras_are_too_few(tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match=r"2 cameras \(cam00, cam01\); at least 3"):
        open_capture(folders.neu3dv(tmp_path / "scene", count=2, frames=2))


def test_camera_0_of_meetroom_is_held_out(tmp_path: Path) -> None:
    scene = folders.neu3dv(tmp_path / "discussion")
    for file in sorted(scene.glob("cam*.mp4")):
        file.rename(scene / f"cam_{int(file.stem[3:])}.mp4")
    capture = open_capture(scene)
    assert capture.held_out == ["cam_0"]
    capture.close()


@pytest.mark.parametrize("fps", [1e-300, 1e6])
def test_unsupported_frame_rates_are_refused(scene: Path, fps: float) -> None:
    (scene / "splatreel.json").write_text(json.dumps({"fps": fps}))
    with pytest.raises(CaptureError, match=r"frames a second, expected 0\.001 to 100000"):
        open_capture(scene)


def test_images_in_folders_of_cameras_are_read(scene: Path) -> None:
    for c, file in enumerate(sorted(scene.glob("*.mp4"))):
        file.unlink()
        (scene / file.stem / "images").mkdir(parents=True)
        for t in range(11):
            Image.fromarray(folders.frame(c, t)).save(scene / file.stem / "images" / f"{t}.png")
    capture = open_capture(scene)
    assert (capture.frames, capture.held_out) == (11, ["cam00"])
    assert [folders.which(image) for image in capture.read(9, 2, ["cam02"])[:, 0]] == [(2, 9), (2, 10)]


def test_videos_with_other_suffixes_and_numbers_without_padding_are_read(tmp_path: Path) -> None:
    scene = folders.neu3dv(tmp_path / "scene", count=12, frames=1)
    for c in range(12):
        (scene / f"cam{c:02d}.mp4").rename(scene / f"cam{c + 1}{('.MP4', '.mov')[c % 2]}")
    (scene / "._cam1.MP4").write_bytes(b"Mac OS X")
    capture = open_capture(scene)
    assert [camera.name for camera in capture.cameras] == [f"cam{c + 1}" for c in range(12)]
    np.testing.assert_allclose(capture.camera("cam10").viewmat, folders.cameras(12)[9].viewmat, atol=1e-6)
    assert "in the order of the cameras' numbers: cam1, cam2" in capture.notes[0]
    capture.close()


@pytest.mark.parametrize("has_row", [True, False])
@pytest.mark.parametrize("has_video", [True, False])
def test_camera_may_be_left_out_with_or_without_its_row(scene: Path, has_row: bool, has_video: bool) -> None:
    if not has_row:
        np.save(scene / "poses_bounds.npy", np.delete(np.load(scene / "poses_bounds.npy"), 1, 0))
    if has_video:
        (scene / "cam01.mp4").write_bytes(b"damaged")
    else:
        (scene / "cam01.mp4").unlink()
    capture = open_capture(scene, leave_out=["cam01"])
    assert [camera.name for camera in capture.cameras] == ["cam00", "cam02", "cam03"]
    np.testing.assert_allclose(capture.camera("cam02").viewmat, folders.cameras()[2].viewmat, atol=1e-6)
    assert folders.which(capture.read(1, 1, ["cam03"])[0, 0]) == (3, 1)
