import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatreel.base.errors import CaptureError
from splatreel.capture.opening import open_capture
from tests.capture import folders


@pytest.mark.parametrize("make", [True, False], ids=["empty folder", "no folder"])
def test_unknown_layout_lists_supported_ones(tmp_path: Path, make: bool) -> None:
    path = tmp_path / "nothing"
    if make:
        path.mkdir()
    with pytest.raises(CaptureError) as error:
        open_capture(path)
    for name in (
        str(path),
        "poses_bounds.npy",
        "train_meta.json",
        "cameras_parameters.txt",
        "intri.yml",
        "cameras.bin",
    ):
        assert name in str(error.value)


@pytest.mark.parametrize("place", ["", "videos", "synchronized_videos", "raw"])
def test_videos_alone_need_calibration(tmp_path: Path, place: str) -> None:
    (tmp_path / place).mkdir(exist_ok=True)
    for name in ("GX1.MP4", "GX2.mov", "GX3.mp4", "._GX3.mp4"):
        (tmp_path / place / name).write_bytes(b"")
    at = tmp_path / ("raw" if place == "raw" else "")
    with pytest.raises(
        CaptureError, match=rf"{at} holds 3 videos \(GX1, GX2, GX3\) without poses .*capture calibrate {at}`"
    ):
        open_capture(tmp_path)


def test_images_alone_need_calibration(tmp_path: Path) -> None:
    for name in ("a", "b", "c"):
        (tmp_path / name).mkdir()
        Image.new("RGB", (4, 4)).save(tmp_path / name / "0.png")
    with pytest.raises(CaptureError, match=r"images of 3 cameras \(a, b, c\) without poses .*capture calibrate"):
        open_capture(tmp_path)


def test_capture_in_a_subfolder_is_named(tmp_path: Path) -> None:
    shutil.move(folders.neu3dv(tmp_path / "made", frames=1), tmp_path / "coffee")
    with pytest.raises(CaptureError, match=rf"looks like a capture: give {tmp_path / 'coffee'}\."):
        open_capture(tmp_path)
    shutil.copytree(tmp_path / "coffee", tmp_path / "tea")
    with pytest.raises(
        CaptureError, match=r"Its folders coffee, tea look like captures: give one of them, such as .*coffee"
    ):
        open_capture(tmp_path)


@pytest.mark.parametrize(
    ("name", "camera"),
    [
        ("cam{c:02d}_{t:04d}", "cam00"),
        ("cam_{c}-frame{t:04d}", "cam_0"),
        ("{c:02d}_{t:04d}", "00"),
        ("{t:04d}_cam{c:02d}", "cam00"),
        ("frame{t:04d}.view{c}", "view0"),
    ],
)
@pytest.mark.parametrize("kind", ["alone", "poses_bounds", "colmap"])
def test_images_of_all_cameras_in_one_folder(tmp_path: Path, name: str, camera: str, kind: str) -> None:
    place = tmp_path / ("images" if kind == "colmap" else "")
    if kind == "colmap":
        pytest.importorskip("pycolmap")
        folders.colmap_model(tmp_path, folders.cameras())
    elif kind == "poses_bounds":
        np.save(tmp_path / "poses_bounds.npy", folders.llff(folders.cameras()))
    place.mkdir(exist_ok=True)
    for c in range(4):
        for t in range(1, 3):
            Image.new("RGB", (32, 24)).save(place / f"{name.format(c=c, t=t)}.png")
    with pytest.raises(CaptureError, match=rf"images of 4 cameras in one folder.* such as {camera}/.*\.png"):
        open_capture(tmp_path)


def test_images_of_one_camera_get_no_such_advice(tmp_path: Path) -> None:
    for t in range(6):
        Image.new("RGB", (4, 4)).save(tmp_path / f"IMG_{t:04d}.png")
    with pytest.raises(CaptureError, match="holds none of these"):
        open_capture(tmp_path)


def test_videos_that_are_not_read_are_named(tmp_path: Path) -> None:
    for c in range(4):
        (tmp_path / f"cam{c:02d}.BRAW").touch()
    with pytest.raises(CaptureError, match=r"Videos in .* are not read: cam00\.BRAW, .*Convert \.braw to \.mp4"):
        open_capture(tmp_path)
