import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from splatreel.base.errors import CaptureError
from splatreel.capture.opening import open_capture
from tests.capture import blobs

pytest.importorskip("pycolmap")

NAMES = [f"camera_{c + 1:04d}" for c in range(4)]
CAMERA: dict[str, Any] = {
    "width": blobs.WIDTH,
    "height": blobs.HEIGHT,
    "focal_length": 140.0,
    "principal_point": [83.0, 58.5],
    "pixel_aspect_ratio": 1.02,
    "projection_type": "fisheye",
    "radial_distortion": [0.06, -0.02, 0],
}


def project(c: int) -> np.ndarray:
    """Project as cv2.fisheye, which HyperReel and SpacetimeGaussians call; the center of the first pixel is at (0.5, 0.5)."""
    R, t = blobs.poses()[c]
    X, Y, Z = R @ blobs.POINTS.T + t[:, None]
    r = np.hypot(X, Y)
    angle = np.arctan2(r, Z)
    k1, k2, _ = CAMERA["radial_distortion"]
    bent = angle * (1 + k1 * angle**2 + k2 * angle**4)
    cx, cy = CAMERA["principal_point"]
    u = cx + CAMERA["focal_length"] * bent * X / r
    v = cy + CAMERA["focal_length"] * CAMERA["pixel_aspect_ratio"] * bent * Y / r
    return np.stack([u, v], 1)


def write(folder: Path, **changes: Any) -> Path:
    entries = []
    for name, (R, t) in zip(NAMES, blobs.poses(), strict=True):
        place = {"position": (-R.T @ t).tolist(), "orientation": Rotation.from_matrix(R).as_rotvec().tolist()}
        entries.append({"name": name, **CAMERA, **place, **changes})
    (folder / "models.json").write_text(json.dumps(entries))
    blobs.write(folder, NAMES, project, first=0.5)
    return folder


def test_fisheye_cameras(tmp_path: Path) -> None:
    capture = open_capture(write(tmp_path))
    assert ([c.name for c in capture.cameras], capture.layout) == (NAMES, "Google Immersive")
    assert blobs.errors(capture).max() < 0.1


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"projection_type": "equirectangular"}, r"camera_0001: is 'equirectangular'.*transforms\.json"),
        ({"radial_distortion": [0.1, 0, 0.2]}, r"radial distortion \[0\.1, 0\.0, 0\.2\].*2 coefficients"),
        ({"focal_length": 0}, "focal length 0"),
        ({"position": [0, 1]}, r"camera_0001: cannot be read"),
        ({"position": [0, 1, float("nan")]}, r"models\.json"),
    ],
)
def test_unusable_cameras_are_named(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(CaptureError, match=message):
        open_capture(write(tmp_path, **changes))
