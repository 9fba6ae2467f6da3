from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import CaptureError
from splatreel.capture.opening import open_capture
from tests.capture import blobs

pytest.importorskip("pycolmap")

LEFT, TOP = 16, 8
CENTER = np.array([5300.0, 3700.0])
"""Principal point on the sensor in 64ths of a pixel."""


def project(c: int) -> np.ndarray:
    """Project to pixels of the film's field of view, whose first pixel has its center at 0.5.

    The camera looks along -z with y up. A pixel has 64 subpixels, and the first subpixel of the sensor is 0.
    """
    R, t = blobs.poses()[c]
    right, up, back = -np.diag([-1.0, 1, 1]) @ R
    center = -R.T @ t
    away = blobs.POINTS - center
    x, y = away @ right / -(away @ back), -(away @ up) / -(away @ back)
    k1, k2, p1, p2, k3 = blobs.BENDS
    square = x**2 + y**2
    stretch = 1 + k1 * square + k2 * square**2 + k3 * square**3
    bent = np.stack(
        [
            x * stretch + 2 * p1 * x * y + p2 * (square + 2 * x**2),
            y * stretch + p1 * (square + 2 * y**2) + 2 * p2 * x * y,
        ],
        1,
    )
    subpixels = bent * blobs.FOCAL * 64 + CENTER + 0.5
    return subpixels / 64 - (LEFT, TOP)


def write(folder: Path) -> Path:
    cameras = []
    for c in range(4):
        R, t = blobs.poses()[c]
        axes = np.diag([1.0, -1, -1]) @ R
        center = -R.T @ t * 1000
        elements = " ".join(f'r{i + 1}{j + 1}="{axes[i, j]}"' for i in range(3) for j in range(3))
        k1, k2, p1, p2, k3 = blobs.BENDS
        cameras.append(
            f'<camera active="1" avg-residual="0.4" serial="2658{c}" model="Miqus Video" viewrotation="0">'
            f'<fov_video left="{LEFT}" top="{TOP}" right="{LEFT + 159}" bottom="{TOP + 119}"/>'
            f'<transform x="{center[0]}" y="{center[1]}" z="{center[2]}" {elements}/>'
            f'<intrinsic focalLengthU="{blobs.FOCAL * 64}" focalLengthV="{blobs.FOCAL * 64}" centerPointU="{CENTER[0]}" '
            f'centerPointV="{CENTER[1]}" skew="0.0" radialDistortion1="{k1}" radialDistortion2="{k2}" '
            f'radialDistortion3="{k3}" tangentalDistortion1="{p1}" tangentalDistortion2="{p2}"/></camera>'
        )
    markers = '<camera serial="99" model="Oqus 300+"/>'
    text = f'<?xml version="1.0"?><calibration><cameras>{"".join(cameras)}{markers}</cameras></calibration>'
    (folder / "take.qca.txt").write_text(text)
    blobs.write(folder / "videos", [f"take_Miqus_{c + 1}_2658{c}" for c in range(4)], project, first=0.5)
    return folder


def test_video_cameras_are_read_in_meters(tmp_path: Path) -> None:
    """The names of the videos end with the camera's serial number."""
    write(tmp_path)
    capture = open_capture(tmp_path)
    assert ([c.name for c in capture.cameras], capture.layout) == ([f"2658{c}" for c in range(4)], "Qualisys")
    R, t = blobs.poses()[0]
    np.testing.assert_allclose(capture.cameras[0].center, -R.T @ t, atol=1e-5)
    assert blobs.errors(capture).max() < 0.1


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('viewrotation="0"', 'viewrotation="90"', r"camera 26580: its view is turned by 90 degrees"),
        ("Miqus Video", "Oqus 300", r"take\.qca\.txt: holds no camera that films"),
        ('centerPointU="5300.0" ', "", r"camera 26580: has no 'centerPointU'"),
        ("<transform", "<placed", r"camera 26580: has no 'transform'"),
        ("</calibration>", "", r"take\.qca\.txt: is not a complete XML file"),
        ("<calibration>", "<!DOCTYPE x><calibration>", r"declares a document type"),
    ],
)
def test_unusable_files_are_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    file = write(tmp_path) / "take.qca.txt"
    file.write_text(file.read_text().replace(old, new))
    with pytest.raises(CaptureError, match=message):
        open_capture(tmp_path)
