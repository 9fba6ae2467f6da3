"""Folders that are no captures: the message names what they hold and the command that helps."""

import shutil
from pathlib import Path

import pytest
from PIL import Image

from splatreel.capture.opening import open_capture
from splatreel.errors import CaptureError
from tests.capture import folders


@pytest.mark.parametrize("place", ["", "videos", "synchronized_videos", "raw"])
def test_videos_alone_need_calibration(tmp_path: Path, place: str) -> None:
    (tmp_path / place).mkdir(exist_ok=True)
    for name in ("GX1.MP4", "GX2.mov", "GX3.mp4", "._GX3.mp4"):
        (tmp_path / place / name).write_bytes(b"")
    at = tmp_path / ("raw" if place == "raw" else "")
    with pytest.raises(
        CaptureError, match=rf"{at} holds 3 videos \(GX1, GX2, GX3\) without poses .*capture calibrate {at}`"
    ):
        open_capture(tmp_path)


def test_pictures_alone_need_calibration(tmp_path: Path) -> None:
    for name in ("a", "b", "c"):
        (tmp_path / name).mkdir()
        Image.new("RGB", (4, 4)).save(tmp_path / name / "0.png")
    with pytest.raises(CaptureError, match=r"pictures of 3 cameras \(a, b, c\) without poses .*capture calibrate"):
        open_capture(tmp_path)


def test_capture_in_a_subfolder_is_named(tmp_path: Path) -> None:
    shutil.move(folders.neu3dv(tmp_path / "made", frames=1), tmp_path / "coffee")
    with pytest.raises(CaptureError, match=rf"looks like a capture: give {tmp_path / 'coffee'}\."):
        open_capture(tmp_path)
