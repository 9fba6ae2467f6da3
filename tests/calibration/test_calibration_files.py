""""""

import json
import os
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatreel.base.errors import CaptureError
from splatreel.base.progress import Silent
from splatreel.calibration.calibrate import move_into_place
from splatreel.calibration.calibration_files import calibration_record, check_photos, is_made_by, write_photos
from splatreel.cli.main import main


def png_header(width: int, height: int) -> bytes:
    """Return the start of a PNG file that claims a size."""
    body = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + body + struct.pack(">I", zlib.crc32(body))


@pytest.mark.parametrize("content", [b"", b"no image", png_header(1_000_000, 1_000_000), png_header(0, 10)])
def test_files_that_are_no_images_are_named(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(CaptureError, match=r"a\.png"):
        write_photos(check_photos(tmp_path), tmp_path / "pictures", Silent())


@pytest.mark.skipif(os.name != "posix", reason="pipes")
def test_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.png")
    with pytest.raises(CaptureError):
        write_photos(check_photos(tmp_path), tmp_path / "pictures", Silent())


def test_truncated_photograph_is_named(tmp_path: Path) -> None:
    Image.fromarray(np.random.default_rng(0).integers(0, 255, (64, 64, 3), np.uint8)).save(tmp_path / "a.png")
    data = (tmp_path / "a.png").read_bytes()
    (tmp_path / "a.png").write_bytes(data[: len(data) // 2])
    with pytest.raises(CaptureError, match=r"a\.png"):
        write_photos(check_photos(tmp_path), tmp_path / "pictures", Silent())


OPTIONS = {"board": "5x7:0.035"}


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """Return a capture that was calibrated just now."""
    scene, made = tmp_path / "scene", tmp_path / "made"
    made.mkdir()
    scene.mkdir()
    for name in ("cameras.bin", "images.bin", "points3D.bin"):
        (made / name).write_bytes(name.encode())
    for name in ("a", "b", "c"):
        (scene / f"{name}.mp4").write_bytes(name.encode())
    move_into_place(made, scene, calibration_record(scene, OPTIONS, []))
    return scene


def test_the_same_command_has_the_same_record(scene: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert is_made_by(scene, calibration_record(scene, OPTIONS, []))
    assert main(["capture", "calibrate", str(scene), "--board", "5x7:0.035"]) == 0
    assert "sparse/0: was complete already, made by the same command" in capsys.readouterr().out
    assert main(["capture", "calibrate", str(scene), "--board", "5x7:0.04"]) == 1
    assert "is calibrated already" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("file", "content"),
    [
        ("a.mp4", "longer"),
        ("d.mp4", "d"),
        ("sparse/0/images.bin", "other"),
        ("sparse/0/images.txt", "more"),
        ("splatreel.json", json.dumps({"starts": {"a": 0.5}})),
        ("sparse/0/calibration.json", "[" * 100_000),
        ("sparse/0/calibration.json", "{}"),
    ],
)
def test_anything_else_is_another_calibration(scene: Path, file: str, content: str) -> None:
    (scene / file).write_text(content)
    assert not is_made_by(scene, calibration_record(scene, OPTIONS, []))


def test_other_options_and_folders_are_another_calibration(scene: Path) -> None:
    assert not is_made_by(scene, calibration_record(scene, {"board": "5x7:0.04"}, []))
    photos = scene.parent / "photos"
    photos.mkdir()
    (photos / "1.jpg").write_bytes(b"1")
    assert not is_made_by(scene, calibration_record(scene, OPTIONS, [photos]))


def test_models_of_other_programs_are_not_taken_for_it(scene: Path) -> None:
    (scene / "sparse" / "0" / "calibration.json").unlink()
    assert not is_made_by(scene, calibration_record(scene, OPTIONS, []))
    assert not is_made_by(scene / "none", calibration_record(scene, OPTIONS, []))
