import time
from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import CaptureError
from splatreel.capture.readers.calibrations.opencv_storage import OpenCVStorage

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
