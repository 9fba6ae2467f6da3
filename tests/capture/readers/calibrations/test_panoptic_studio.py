import json
from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import CaptureError
from splatreel.capture.opening import open_capture
from tests.capture import blobs, folders

pytest.importorskip("pycolmap")

K = np.array([[blobs.FOCAL, 0, 82.0], [0, blobs.FOCAL, 58.5], [0, 0, 1]])


def project(c: int) -> np.ndarray:
    """Project as `projectPoints` of the toolbox's python/panutils.py, which follows OpenCV."""
    R, t = blobs.poses()[c]
    x, y, z = R @ blobs.POINTS.T + t[:, None]
    x, y = x / z, y / z
    k1, k2, p1, p2, k3 = blobs.BENDS
    r = x * x + y * y
    bent_x = x * (1 + k1 * r + k2 * r * r + k3 * r**3) + 2 * p1 * x * y + p2 * (r + 2 * x * x)
    bent_y = y * (1 + k1 * r + k2 * r * r + k3 * r**3) + 2 * p2 * x * y + p1 * (r + 2 * y * y)
    return np.stack([K[0, 0] * bent_x + K[0, 2], K[1, 1] * bent_y + K[1, 2]], 1)


def write(folder: Path, kind: str = "hd") -> Path:
    folder.mkdir()
    cameras = []
    for c, (R, t) in enumerate(blobs.poses()):
        camera = {"name": f"00_{c + 5:02d}", "type": kind, "resolution": [160, 120], "panel": 0, "node": c + 5}
        camera |= {"K": K.tolist(), "distCoef": list(blobs.BENDS), "R": R.tolist(), "t": t[:, None].tolist()}
        cameras.append(camera)
    cameras.append(cameras[0] | {"name": "01_01", "type": "vga", "resolution": [640, 480], "panel": 1, "node": 1})
    (folder / f"calibration_{folder.name}.json").write_text(
        json.dumps({"calibDataSource": "160422_calib_norm", "cameras": cameras})
    )
    return folder


def test_hd_images(tmp_path: Path) -> None:
    scene = write(tmp_path / "171204_pose1")
    for c in range(4):
        blobs.save(scene / "hdImgs", f"00_{c + 5:02d}", blobs.draw(project(c), 0))
    capture = open_capture(scene)
    assert ([c.name for c in capture.cameras], capture.layout) == (
        ["00_05", "00_06", "00_07", "00_08"],
        "Panoptic Studio",
    )
    assert blobs.errors(capture).max() < 0.1


def test_hd_videos_of_some_cameras(tmp_path: Path) -> None:
    """getData.sh downloads as many videos as one asks for."""
    scene = write(tmp_path / "171204_pose1")
    (scene / "hdVideos").mkdir()
    for c in range(3):
        frames = [folders.frame(c, t, blobs.WIDTH, blobs.HEIGHT) for t in range(2)]
        folders.write_video(scene / "hdVideos" / f"hd_00_{c + 5:02d}.mp4", frames)
    capture = open_capture(scene)
    assert ([c.name for c in capture.cameras], capture.frames) == (["00_05", "00_06", "00_07"], 2)
    assert folders.which(capture.read(1, 1, ["00_06"])[0, 0]) == (1, 1)
    assert "1 cameras of calibration_171204_pose1.json have no videos" in " ".join(capture.notes)
    capture.close()


def test_unusable_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match="holds no HD cameras"):
        open_capture(write(tmp_path / "vga", "vga"))
    file = write(tmp_path / "scene") / "calibration_scene.json"
    file.write_text(file.read_text().replace('"R": [[', '"R": [[7'))
    with pytest.raises(CaptureError, match=r"camera 00_05: its rotation is .*no rotation"):
        open_capture(tmp_path / "scene")
