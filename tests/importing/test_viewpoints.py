import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from splatreel.base.errors import CaptureError
from splatreel.importing.viewpoints import RING, read_camera_file, read_cameras, ring
from splatreel.play.timeline import draw_on_cpu
from splatreel.scene.camera import Camera
from tests.capture import blobs, folders
from tests.capture.readers import test_transforms
from tests.capture.readers.calibrations import test_toml_cameras
from tests.importing.films import cameras, scene
from tests.method.captures import WallCapture

pytest.importorskip("pycolmap")
pytest.importorskip("cv2")


def test_calibrations_need_no_images(tmp_path: Path) -> None:
    file = tmp_path / "calibration.toml"
    file.write_text("".join(test_toml_cameras.table(c, f"cam_{c}") for c in range(4)))
    frames = [{"file_path": f"{c}.png", "transform_matrix": test_transforms.matrix(c).tolist()} for c in range(4)]
    test_transforms.write(tmp_path, test_transforms.PERSPECTIVE, frames)
    for found in (read_camera_file(file), read_cameras(tmp_path / "transforms.json")):
        assert found is not None
        for camera, (R, t) in zip(found, blobs.poses(), strict=True):
            np.testing.assert_allclose(camera.viewmat[:3], np.concatenate([R, t[:, None]], 1), atol=1e-6)
            assert (camera.width, camera.height) == (160, 120)


def test_other_files_are_not_read(tmp_path: Path) -> None:
    (tmp_path / "cameras.json").write_text("[]")
    assert read_camera_file(tmp_path / "cameras.json") is None


def test_unknown_sizes_are_an_error(tmp_path: Path) -> None:
    frames = [{"file_path": f"{c}.png", "transform_matrix": test_transforms.matrix(c).tolist()} for c in range(4)]
    test_transforms.write(tmp_path, {"camera_angle_x": 1.0}, frames)
    with pytest.raises(CaptureError, match=r"does not state the size of the images of camera 0\. Name the folder"):
        read_camera_file(tmp_path / "transforms.json")


def entry(camera: Camera, index: int) -> dict[str, Any]:
    """Return a camera as 3DGS writes it: inverse of world to camera, by rotation and position."""
    inverse = np.linalg.inv(camera.viewmat.astype(np.float64))
    size = {"width": camera.width, "height": camera.height, "fx": float(camera.K[0, 0]), "fy": float(camera.K[1, 1])}
    pose = {"position": inverse[:3, 3].tolist(), "rotation": inverse[:3, :3].tolist()}
    return {"id": index, "img_name": camera.name} | size | pose


def test_cameras_json_gives_correct_poses(tmp_path: Path) -> None:
    truth = cameras()
    file = tmp_path / "cameras.json"
    file.write_text(json.dumps([entry(camera, index) for index, camera in enumerate(truth)]))
    for place in (file, tmp_path):
        for found, camera in zip(read_cameras(place), truth, strict=True):
            assert (found.name, found.width, found.height) == (camera.name, camera.width, camera.height)
            np.testing.assert_allclose(found.viewmat, camera.viewmat, atol=1e-5)
            np.testing.assert_allclose(found.K, camera.K)


def test_read_cameras_accepts_a_capture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    capture = WallCapture(1)
    monkeypatch.setattr("splatreel.importing.viewpoints.open_capture", lambda path: capture)
    assert read_cameras(tmp_path) == capture.cameras


@pytest.mark.parametrize(
    "text",
    ["", "[]", "{}", "[1]", '[{"id": 0}]', json.dumps([entry(cameras()[0], 0) | {"width": 0}])],
    ids=["nothing", "none", "no list", "a number", "no pose", "no size"],
)
def test_invalid_cameras_json_is_refused(tmp_path: Path, text: str) -> None:
    file = tmp_path / "cameras.json"
    file.write_text(text)
    with pytest.raises(CaptureError, match=r"cameras\.json"):
        read_cameras(file)


def test_mirrored_cameras_are_refused_with_their_file(tmp_path: Path) -> None:
    mirrored = entry(cameras()[0], 0)
    mirrored["rotation"] = (np.array(mirrored["rotation"]) * [-1, 1, 1]).tolist()
    file = tmp_path / "cameras.json"
    file.write_text(json.dumps([mirrored]))
    with pytest.raises(CaptureError, match="it mirrors") as caught:
        read_cameras(file)
    assert str(caught.value).startswith(f"{file}: camera 'cam0'")


@pytest.mark.parametrize("up", [(0, -1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 0)])
def test_ring_surrounds_the_scene_upright(up: tuple[int, int, int]) -> None:
    points, above = scene(), np.array(up, float)
    views = ring(points, above)
    assert len(views) == RING
    middle = np.median(points.means, axis=0)
    for camera in views:
        turn = camera.viewmat[:3, :3]
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-6)
        assert np.linalg.det(turn) == pytest.approx(1)
        assert -turn[1] @ above > 0.9, "the image's up is the world's"
        x, y, depth = camera.K @ (turn @ middle + camera.viewmat[:3, 3])
        assert (x / depth, y / depth) == pytest.approx((camera.width / 2, camera.height / 2), abs=1e-2)
    image = draw_on_cpu(points, views[0].at_most(240), 0.01, False, (0.0, 0.0, 0.0))
    assert 0.1 < (image.max(2) > 0.1).mean() < 0.9


def test_colmap_model_needs_no_images(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    made = folders.colmap_model(tmp_path / "scene", folders.cameras())
    for place in (made, made / "sparse" / "0"):
        found = read_cameras(place)
        assert [camera.name for camera in found] == [f"cam{c:02d}/000000" for c in range(4)]
        np.testing.assert_allclose(found[2].viewmat, folders.cameras()[2].viewmat, atol=1e-5)
