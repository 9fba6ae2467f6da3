from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import CaptureError
from splatreel.capture.readers.camera_files import read_camera_file
from splatreel.importing.viewpoints import read_cameras
from tests.capture import blobs
from tests.capture.readers import test_transforms
from tests.capture.readers.calibrations import test_toml_cameras

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
