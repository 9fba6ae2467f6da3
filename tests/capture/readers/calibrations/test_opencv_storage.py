from pathlib import Path

import numpy as np
import pytest

from splatreel.capture.readers.calibrations.opencv_storage import OpenCVStorage
from splatreel.errors import CaptureError

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
