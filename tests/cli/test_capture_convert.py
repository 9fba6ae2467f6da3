from pathlib import Path

import pytest

from splatreel.capture.opening import open_capture
from splatreel.cli.main import main
from tests.capture import folders

pytest.importorskip("pycolmap")
pytest.importorskip("cv2")


def test_capture_convert(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene, out = folders.panoptic(tmp_path / "scene"), tmp_path / "out"
    assert main(["capture", "convert", str(scene), str(out), "--frames", "1:3", "--width", "16"]) == 0
    text = capsys.readouterr().out
    assert f"{out}: 4 cameras and 2 frames of 16 x 12 pixels" in text
    assert "intri.yml and extri.yml of EasyVolcap, the COLMAP model sparse/0" in text
    capture = open_capture(out)
    assert (capture.frames, capture.width) == (2, 16)
    assert folders.which(capture.read(1, 1, ["12"])[0, 0]) == (2, 2)


def test_new_names_are_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = folders.colmap(tmp_path / "scene")
    assert main(["capture", "convert", str(scene), str(tmp_path / "out"), "--format", "png"]) == 0
    assert "view/cam00 is now view_cam00" in capsys.readouterr().out


def test_existing_folders_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = folders.panoptic(tmp_path / "scene")
    assert main(["capture", "convert", str(scene), str(scene)]) == 2
    assert "scene: is the folder that this command reads. Choose another place." in capsys.readouterr().err
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "notes.txt").write_text("mine")
    assert main(["capture", "convert", str(scene), str(tmp_path / "other")]) == 1
    assert "other: exists already. Name a new folder." in capsys.readouterr().err


@pytest.mark.parametrize("kind", ["jpg", "png"])
def test_conversion_that_is_complete_already_says_so(
    tmp_path: Path, kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """A command may be killed just after it finished. Another conversion is not taken for it."""
    scene, out = folders.panoptic(tmp_path / "scene"), tmp_path / "out"
    command = ["capture", "convert", str(scene), str(out), "--format", kind]
    assert main(command) == 0
    before = {file: file.read_bytes() for file in out.rglob("*") if file.is_file()}
    capsys.readouterr()
    assert main(command) == 0
    assert f"{out}: was complete already, with the same content" in capsys.readouterr().out
    assert main([*command, "--width", "16"]) == 1
    assert f"{out}: exists already. Name a new folder." in capsys.readouterr().err
    assert {file: file.read_bytes() for file in out.rglob("*") if file.is_file()} == before
