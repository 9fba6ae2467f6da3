import shutil
from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import CaptureError
from splatreel.capture.opening import open_capture
from tests.capture import folders

pytest.importorskip("pycolmap")
cv2 = pytest.importorskip("cv2")


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    return folders.easyvolcap(tmp_path / "actor1")


def rewrite(scene: Path, file: str, old: str, new: str) -> None:
    content = (scene / file).read_text()
    assert old in content
    (scene / file).write_text(content.replace(old, new))


def test_easyvolcap_cameras_and_frames(scene: Path) -> None:
    """K is for images twice as large."""
    capture = open_capture(scene)
    assert ([c.name for c in capture.cameras], capture.held_out) == (["00", "01", "02", "03"], ["01"])
    assert (capture.frames, capture.fps, capture.width, capture.height) == (3, 30.0, 32, 24)
    for found, written in zip(capture.cameras, folders.cameras(), strict=True):
        np.testing.assert_allclose(found.viewmat, written.viewmat, atol=1e-6)
        np.testing.assert_allclose(found.K, written.K, atol=1e-4)
    assert [folders.which(image) for image in capture.read(1, 2, ["02"])[:, 0]] == [(2, 1), (2, 2)]


def test_rotation_vectors_are_accepted(scene: Path) -> None:
    matrices = open_capture(scene)
    rewrite(scene, "extri.yml", "Rot_", "Other_")
    for found, other in zip(open_capture(scene).cameras, matrices.cameras, strict=True):
        np.testing.assert_allclose(found.viewmat, other.viewmat, atol=1e-6)


def test_sizes_default_to_the_images(tmp_path: Path) -> None:
    scene = folders.easyvolcap(tmp_path / "actor1", size=1)
    for key in ("W_", "H_"):
        rewrite(scene, "intri.yml", key, f"not_{key}")
    np.testing.assert_allclose(open_capture(scene).cameras[1].K, folders.cameras()[1].K, atol=1e-5)


def test_easyvolcap_lens_distortion_is_removed(tmp_path: Path) -> None:
    """The colors of the images encode the direction of each pixel, through OpenCV's own lens model."""
    bends = (-0.15, 0.02, 0.004, -0.003, 0.01)
    scene = folders.easyvolcap(tmp_path / "actor1", bends=bends, size=1)
    y, x = np.mgrid[:24, :32].astype(float) + 0.5
    pixels = np.stack([x.ravel(), y.ravel()], 1)[:, None]
    rays = cv2.undistortPoints(pixels, folders.cameras()[0].K.astype(float), np.array(bends)).reshape(24, 32, 2)
    colors = np.concatenate([128 + 200 * rays, np.full((24, 32, 1), 7)], 2)
    for file in (scene / "images").rglob("*.png"):
        cv2.imwrite(str(file), colors[..., ::-1].round().astype(np.uint8))
    capture = open_capture(scene)
    image, K = capture.read(0, 1, ["01"])[0, 0].astype(float), capture.camera("01").K
    assert K[0, 0] != pytest.approx(40.0)
    np.testing.assert_allclose(image[..., 0], 128 + 200 * (x - K[0, 2]) / K[0, 0], atol=1.5)
    np.testing.assert_allclose(image[..., 1], 128 + 200 * (y - K[1, 2]) / K[1, 1], atol=1.5)


def test_easyvolcap_videos_are_read(scene: Path) -> None:
    shutil.rmtree(scene / "images")
    (scene / "videos").mkdir()
    for c in range(4):
        folders.write_video(scene / "videos" / f"{c:02d}.mp4", [folders.frame(c, t) for t in range(5)])
    capture = open_capture(scene, frames=(1, 5))
    assert (capture.frames, capture.width) == (4, 32)
    assert folders.which(capture.read(1, 1, ["03"])[0, 0]) == (3, 2)
    capture.close()


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("intri.yml", "K_02", "L_02", r"intri\.yml: has no K_02, though camera 02 is listed"),
        ("extri.yml", "T_01", "U_01", r"extri\.yml: has no T_01"),
        ("intri.yml", "80., 0., 32.", "-80., 0., 32.", r"K_00 is .*focal lengths must be positive"),
        ("intri.yml", "80., 0., 32.", "80., .Nan, 32.", r"intri\.yml: K_00: cannot be read .*Nan"),
        ("intri.yml", "names:", "people:", r"lists no cameras under `names`"),
        ("intri.yml", "rows: 5", "rows: 500000000", r"intri\.yml: D_00: cannot be read"),
        ("intri.yml", "W_01:", "W_01: wide\nX_01:", r"intri\.yml: W_01 is 'wide', no finite number"),
        ("intri.yml", "H_01:", "H_01: .Inf\nX_01:", r"intri\.yml: H_01 is '.Inf', no finite number"),
        ("intri.yml", '"03"', "[ 3 ]", r"first is '\[ 3 \]'"),
        ("intri.yml", '"03"', '"07"', r"1 of the 4 cameras in intri\.yml have neither images .* first is '07'"),
    ],
)
def test_unusable_camera_files_are_named(scene: Path, file: str, old: str, new: str, message: str) -> None:
    rewrite(scene, file, old, new)
    with pytest.raises(CaptureError, match=message):
        open_capture(scene)


def test_invalid_rotations_are_refused(scene: Path) -> None:
    storage = cv2.FileStorage(str(scene / "extri.yml"), cv2.FILE_STORAGE_WRITE)
    for c in range(4):
        storage.write(f"Rot_{c:02d}", np.diag([1.0, 1.0, -1.0]))
        storage.write(f"T_{c:02d}", np.array([[c], [0], [4.0]]))
    storage.release()
    with pytest.raises(CaptureError, match=r"extri\.yml: Rot_00 is .*no rotation"):
        open_capture(scene)


def test_missing_image_costs_only_its_camera(scene: Path) -> None:
    (scene / "images" / "01" / "000001.png").unlink()
    capture = open_capture(scene)
    assert capture.frames == 3
    assert capture.missing(0, 3, ["00", "01"]).tolist() == [[False, False], [False, True], [False, False]]
    assert [folders.which(image) for image in capture.read(0, 3, ["01"])[:, 0]] == [(1, 0), (1, 0), (1, 2)]
    assert capture.notes == ["01 has no images 1: left out of training for that camera only"]


def test_start_times_need_videos(scene: Path) -> None:
    (scene / "splatreel.json").write_text('{"starts": {"00": 0.5}}')
    with pytest.raises(CaptureError, match=r"splatreel\.json: has start times of videos, but the cameras have images"):
        open_capture(scene)


def test_foreign_camera_file_is_named(scene: Path) -> None:
    (scene / "intri.yml").write_text("")
    with pytest.raises(CaptureError, match=r"intri\.yml: is not a YAML file of OpenCV's.*Export the cameras again"):
        open_capture(scene)
