import csv
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from splatreel.base.errors import CaptureError
from splatreel.capture.opening import open_capture
from tests.capture import blobs

NAMES = [f"Cam{c + 1:03d}" for c in range(4)]
FOCAL, CENTER = (0.95, 1.25), (0.52, 0.48)
"""Multiples of the width and the height."""


def project(c: int) -> np.ndarray:
    """Project as `CameraData.projection_matrix_world2pixel`; the center of the first pixel is at (0.5, 0.5)."""
    R, t = blobs.poses()[c]
    K = np.array(
        [
            [blobs.WIDTH * FOCAL[0], 0, blobs.WIDTH * CENTER[0]],
            [0, blobs.HEIGHT * FOCAL[1], blobs.HEIGHT * CENTER[1]],
            [0, 0, 1],
        ]
    )
    X, Y, Z = K @ (R @ blobs.POINTS.T + t[:, None])
    return np.stack([X / Z, Y / Z], 1)


def write(folder: Path, images: int = 4) -> Path:
    with open(folder / "calibration.csv", "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["name", "w", "h", "rx", "ry", "rz", "tx", "ty", "tz", "fx", "fy", "px", "py"])
        for name, (R, t) in zip(NAMES, blobs.poses(), strict=True):
            turn = Rotation.from_matrix(R.T).as_rotvec()
            writer.writerow([name, blobs.WIDTH, blobs.HEIGHT, *turn, *(-R.T @ t), *FOCAL, *CENTER])
    blobs.write(folder / "rgbs", NAMES[:images], project, first=0.5)
    for name in NAMES:
        file = folder / "rgbs" / name / "000000.png"
        if file.exists():
            file.rename(file.with_name(f"{name}_rgb000015.png"))
    return folder


def test_cameras_and_images(tmp_path: Path) -> None:
    capture = open_capture(write(tmp_path))
    assert ([c.name for c in capture.cameras], capture.layout) == (NAMES, "ActorsHQ")
    assert blobs.errors(capture).max() < 0.1


def test_masks_are_not_images(tmp_path: Path) -> None:
    write(tmp_path)
    blobs.write(tmp_path / "masks", NAMES, project, first=0.5)
    assert blobs.errors(open_capture(tmp_path)).max() < 0.1


def test_cameras_without_images_are_left_out(tmp_path: Path) -> None:
    capture = open_capture(write(tmp_path, images=3))
    assert [c.name for c in capture.cameras] == NAMES[:3]
    assert "1 cameras of calibration.csv have no videos and are left out" in " ".join(capture.notes)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("0.95", "wide", r"camera Cam001: cannot be read"),
        ("0.95", "-0.95", r"camera Cam001: has the lens.*focal lengths positive"),
        ("0.95", "inf", r"camera Cam001: holds a number that is not finite"),
        ("Cam002", "", r"calibration\.csv: camera 2 has no name"),
    ],
)
def test_unusable_rows_are_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    file = write(tmp_path) / "calibration.csv"
    file.write_text(file.read_text().replace(old, new))
    with pytest.raises(CaptureError, match=message):
        open_capture(tmp_path)
