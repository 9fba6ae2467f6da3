import shutil
from pathlib import Path

import numpy as np
import pytest

from splatreel.capture.calibrate import calibrate
from splatreel.capture.opening import open_capture
from splatreel.capture.synthetic import make_capture
from splatreel.errors import CaptureError
from splatreel.progress import Silent
from tests.capture import folders


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The videos of the toy room."""
    return make_capture(tmp_path_factory.mktemp("film") / "room", frames=1)


def test_cameras_stand_where_they_stood(room: Path, tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    known = open_capture(room)
    videos = tmp_path / "videos"
    videos.mkdir()
    for file in room.glob("*.mp4"):
        shutil.copy(file, videos)
    found = calibrate(videos, Silent())
    assert (sorted(found.placed), found.lost) == ([camera.name for camera in known.cameras], [])
    assert found.error < 1
    assert not list(videos.glob(".calibrate*"))
    capture = open_capture(videos)
    assert (capture.frames, capture.width, capture.height) == (1, known.width, known.height)
    here, there = (np.stack([camera.center for camera in c.cameras]) for c in (capture, known))
    assert np.linalg.norm(fitted(here, there) - there, axis=1).max() < 0.05 * np.ptp(there, axis=0).max()
    with pytest.raises(CaptureError, match="is calibrated already"):
        calibrate(videos, Silent())


def fitted(here: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Points turned, scaled and moved to lie near others [N, 3]."""
    a, b = here - here.mean(0), there - there.mean(0)
    U, S, Vt = np.linalg.svd(a.T @ b)
    flip = np.diag([1, 1, np.sign(np.linalg.det(U @ Vt))])
    return (S @ flip).sum() / (a**2).sum() * a @ U @ flip @ Vt + there.mean(0)


def test_videos_that_show_nothing_are_refused(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    for c in range(3):
        folders.write_video(tmp_path / f"phone{c}.mp4", [folders.frame(c, 0, 128, 96)])
    with pytest.raises(CaptureError, match="only 0 of 3 cameras"):
        calibrate(tmp_path, Silent())
    assert sorted(file.name for file in tmp_path.iterdir()) == ["phone0.mp4", "phone1.mp4", "phone2.mp4"]


def test_too_few_videos_are_refused(tmp_path: Path) -> None:
    folders.write_video(tmp_path / "phone.mp4", [folders.frame(0, 0)])
    with pytest.raises(CaptureError, match=r"1 videos \(phone\.mp4\), at least 3"):
        calibrate(tmp_path, Silent())
