from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from splatreel.base.errors import CaptureError
from splatreel.capture.opening import open_capture
from tests.capture import blobs

pytest.importorskip("pycolmap")

NAMES = ["Camera_B1", "Camera_B2", "Camera_B3", "Camera_B4"]
K = np.array([[150.0, 0, 83], [0, 153, 57], [0, 0, 1]])
D = np.array(blobs.BENDS).reshape(5, 1)


def project(c: int) -> np.ndarray:
    """Project as cv2, whose distortion the data set's reader removes."""
    R, t = blobs.poses()[c]
    return cv2.projectPoints(blobs.POINTS, R, t, K, D)[0].reshape(-1, 2)


def content(as_lists: bool) -> dict[str, Any]:
    """Return the dictionary of annots.npy; CoreView_313 has lists instead of arrays, and more cameras than images."""
    convert = np.ndarray.tolist if as_lists else np.asarray
    poses = blobs.poses()
    cams = {
        "K": [convert(K) for _ in poses],
        "D": [convert(D) for _ in poses],
        "R": [convert(R) for R, _ in poses],
        "T": [convert(1000 * t.reshape(3, 1)) for _, t in poses],
    }
    if as_lists:
        cams = {key: [*values, values[0]] for key, values in cams.items()}
    frame = {"ims": [f"{name}/000000.png" for name in NAMES], "kpts2d": np.zeros((4, 25, 3))}
    return {"cams": cams, "ims": [frame]}


def write(folder: Path, value: Any) -> Path:
    np.save(folder / "annots.npy", value, allow_pickle=True)
    blobs.write(folder, NAMES, project, first=0)
    blobs.write(folder / "mask_cihp", NAMES, project, first=0)
    return folder


@pytest.mark.parametrize("as_lists", [False, True])
def test_cameras_and_images(tmp_path: Path, as_lists: bool) -> None:
    capture = open_capture(write(tmp_path, content(as_lists)))
    assert ([c.name for c in capture.cameras], capture.layout) == (NAMES, "ZJU-MoCap")
    assert blobs.errors(capture).max() < 0.1
    np.testing.assert_allclose(capture.cameras[1].viewmat[:3, 3], blobs.poses()[1][1], atol=1e-5)  # meters


class Evil:
    def __reduce__(self) -> Any:
        return print, ("run by a pickle",)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ({"cams": {"K": []}, "ims": []}, r"annots\.npy: cannot be read"),
        ({"ims": []}, r"annots\.npy: has no 'cams'"),
        ({"cams": content(True)["cams"] | {"T": []}, "ims": content(True)["ims"]}, "'T': 0.* for the 4 cameras"),
        ([1, 2], r"annots\.npy: holds no dictionary"),
        (Evil(), r"asks for builtins\.print"),
    ],
)
def test_unusable_files_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str], value: Any, message: str) -> None:
    with pytest.raises(CaptureError, match=message):
        open_capture(write(tmp_path, np.array(value, object) if not isinstance(value, Evil) else value))
    assert not capsys.readouterr().out


def test_a_damaged_file_is_named(tmp_path: Path) -> None:
    file = write(tmp_path, content(False)) / "annots.npy"
    file.write_bytes(file.read_bytes()[:-200])
    with pytest.raises(CaptureError, match=r"annots\.npy: cannot be read .* Copy it again from the data set"):
        open_capture(tmp_path)
