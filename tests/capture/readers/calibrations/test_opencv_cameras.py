from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import CaptureError
from splatreel.capture.opening import open_capture
from tests.capture import blobs

cv2 = pytest.importorskip("cv2")
pytest.importorskip("pycolmap")

K = np.array([[blobs.FOCAL, 0, 83.0], [0, blobs.FOCAL + 4, 57.0], [0, 0, 1]])
FISHEYE = np.array([0.05, -0.01, 0.002, -0.001])


def project(c: int, fisheye: bool = False) -> np.ndarray:
    R, t = blobs.poses()[c]
    turn = cv2.Rodrigues(R)[0]
    if fisheye:
        points = blobs.POINTS.reshape(-1, 1, 3)
        return cv2.fisheye.projectPoints(points, turn, t.reshape(3, 1), K, FISHEYE)[0].reshape(-1, 2)
    return cv2.projectPoints(blobs.POINTS, turn, t, K, np.array(blobs.BENDS))[0].reshape(-1, 2)


def write_multiview(file: Path, joined: bool, fisheyes: tuple[int, ...] = (1,)) -> None:
    """Write as `saveToFile` of OpenCV's apps/multiview-calibration; `cam_ids` was one string in older versions."""
    storage = cv2.FileStorage(str(file), cv2.FILE_STORAGE_WRITE)
    rotations, translations = (np.array(values) for values in zip(*blobs.poses(), strict=True))
    storage.write("Rs", rotations)
    bends = [FISHEYE if c in fisheyes else np.array(blobs.BENDS) for c in range(4)]
    storage.write("distortions", np.concatenate(bends))
    storage.write("Ks", np.array([K] * 4))
    storage.write("Ts", translations[..., None])
    storage.write("models", np.array([int(c in fisheyes) for c in range(4)]))
    storage.write("image_sizes", np.array([[160, 120]] * 4))
    names = [f"cam_{c}" for c in range(4)]
    storage.write("cam_ids", ",".join(names) if joined else names)
    storage.release()


@pytest.mark.parametrize("joined", [True, False])
def test_multiview_calibration(tmp_path: Path, joined: bool) -> None:
    write_multiview(tmp_path / "result.yaml", joined)
    blobs.write(tmp_path / "images", [f"cam_{c}" for c in range(4)], lambda c: project(c, c == 1), first=0)
    capture = open_capture(tmp_path)
    assert ([c.name for c in capture.cameras], capture.layout) == ([f"cam_{c}" for c in range(4)], "OpenCV")
    assert blobs.errors(capture).max() < 0.1


def write_camera(file: Path, c: int, keys: tuple[str, ...], leave_out: str = "") -> None:
    R, t = blobs.poses()[c]
    storage = cv2.FileStorage(str(file), cv2.FILE_STORAGE_WRITE)
    values = (K, np.array(blobs.BENDS), cv2.Rodrigues(R)[0] if "vec" in keys[2] else R, t)
    for key, value in zip(keys, values, strict=True):
        if key != leave_out:
            storage.write(key, value)
    if file.suffix == ".yml":
        storage.write("image_width", 160)
        storage.write("image_height", 120)
    storage.release()


KEYS = ("camera_matrix", "distortion_coefficients", "rvec", "tvec")


@pytest.mark.parametrize(("suffix", "keys"), [(".yml", KEYS), (".xml", ("K", "D", "R", "T"))])
def test_a_file_per_camera(tmp_path: Path, suffix: str, keys: tuple[str, ...]) -> None:
    (tmp_path / "calib").mkdir()
    for c in range(4):
        write_camera(tmp_path / "calib" / f"cam{c}{suffix}", c, keys)
    blobs.write(tmp_path, [f"cam{c}" for c in range(4)], project, first=0)
    capture = open_capture(tmp_path)
    assert capture.origin == tmp_path / "calib"
    assert blobs.errors(capture).max() < 0.1


def test_unusable_files_are_named(tmp_path: Path) -> None:
    for c in range(4):
        write_camera(tmp_path / f"cam{c}.yml", c, KEYS, leave_out="distortion_coefficients" if c == 2 else "")
    with pytest.raises(CaptureError, match=r"cam2\.yml: has none of distortion_coefficients"):
        open_capture(tmp_path)
    for file in tmp_path.glob("*.yml"):
        file.unlink()
    write_multiview(tmp_path / "result.yaml", True, ())
    text = (tmp_path / "result.yaml").read_text()
    (tmp_path / "result.yaml").write_text(text.replace('"cam_0,cam_1', '"cam_1'))
    with pytest.raises(CaptureError, match=r"result\.yaml: has 4 matrices, .* 3 names and 20 .* do not fit together"):
        open_capture(tmp_path)
    (tmp_path / "result.yaml").write_text(text.replace("Ts:", "Other:"))
    with pytest.raises(CaptureError, match=r"result\.yaml: has no matrix Ts"):
        open_capture(tmp_path)
