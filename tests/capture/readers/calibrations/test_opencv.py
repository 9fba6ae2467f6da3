""""""

import time
from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import CaptureError
from splatreel.capture.opening import open_capture
from splatreel.capture.readers.calibrations.opencv import OpenCVStorage
from tests.capture import blobs

cv2 = pytest.importorskip("cv2")


@pytest.mark.parametrize("name", ["a.yml", "a.xml"])
def test_what_opencv_writes_is_read(tmp_path: Path, name: str) -> None:
    values = {"K": np.arange(9.0).reshape(3, 3) / 7, "Rs": np.arange(24.0).reshape(2, 3, 4), "n": np.array([[3]])}
    storage = cv2.FileStorage(str(tmp_path / name), cv2.FILE_STORAGE_WRITE)
    for key, value in values.items():
        storage.write(key, value)
    storage.write("width", 160)
    storage.write("ids", ["cam_0", "left one", "7"])
    storage.write("joined", "a,b")
    storage.release()
    found = OpenCVStorage(tmp_path / name)
    for key, value in values.items():
        np.testing.assert_array_equal(found.matrix(key), value)
    assert found.first(("height", "width")) == 160
    assert found.first(("height",)) is None
    assert (found.strings("ids"), found.strings("joined")) == (["cam_0", "left one", "7"], ["a", "b"])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("0.5", ".Nan", r"a\.yml: K: cannot be read"),
        ("0.5,", "", r"a\.yml: K: cannot be read"),
        ("rows: 2", "rows: 9", r"3 numbers for the shape|4 numbers for the shape"),
        ("!!opencv-matrix", "!!other", r"a\.yml: has no matrix K"),
    ],
)
def test_damaged_matrices_are_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = (
        "%YAML:1.0\n---\nK: !!opencv-matrix\n   rows: 2\n   cols: 2\n   dt: d\n   data: [ 0.5, 1., 2.,\n       3. ]\n"
    )
    assert old in text
    (tmp_path / "a.yml").write_text(text.replace(old, new))
    with pytest.raises(CaptureError, match=message):
        OpenCVStorage(tmp_path / "a.yml").matrix("K")


def seconds(file: Path, text: str) -> float:
    """Return the processor time that reading a text takes."""
    file.write_text("%YAML:1.0\n---\n" + text)
    start = time.process_time()
    OpenCVStorage(file)
    return time.process_time() - start


@pytest.mark.parametrize(
    "part", [" ", "\n", "\t", "k: [ 1\n", "k: !!opencv-matrix\n rows: 1\n cols: 1\n dt: d\n data: [ 1\n"]
)
def test_time_is_linear_in_the_size_of_the_file(tmp_path: Path, part: str) -> None:
    """Quadratic time would be a hundred times longer for ten times the size."""
    small, large = (seconds(tmp_path / "a.yml", f"a: 1{part * count}x\n") for count in (4_000, 40_000))
    assert large < 40 * max(small, 0.02)


def test_value_keeps_no_blanks_at_its_end(tmp_path: Path) -> None:
    (tmp_path / "a.yml").write_text("%YAML:1.0\n---\nwidth: 160 \t \nmodel: a b  \n")
    assert OpenCVStorage(tmp_path / "a.yml").number("width") == 160


@pytest.mark.parametrize("encoding", ["utf-7", "utf-32", "no-such", "idna", "utf-16"])
def test_declared_encodings_of_xml_raise_no_other_errors(tmp_path: Path, encoding: str) -> None:
    text = f'<?xml version="1.0" encoding="{encoding}"?><opencv_storage><width>160</width></opencv_storage>'
    (tmp_path / "a.xml").write_text(text)
    assert OpenCVStorage(tmp_path / "a.xml").number("width") == 160


def test_numbers_of_thousands_of_digits_are_refused(tmp_path: Path) -> None:
    rows = "9" * 5000
    text = f"%YAML:1.0\n---\nK: !!opencv-matrix\n   rows: {rows}\n   cols: 2\n   dt: d\n   data: [ 1., 2. ]\n"
    (tmp_path / "a.yml").write_text(text)
    with pytest.raises(CaptureError, match=r"a\.yml: cannot be read"):
        OpenCVStorage(tmp_path / "a.yml")
    (tmp_path / "a.xml").write_text(f"<opencv_storage><K><rows>{rows}</rows><data>1</data></K></opencv_storage>")
    with pytest.raises(CaptureError, match=r"a\.xml"):
        OpenCVStorage(tmp_path / "a.xml")


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
