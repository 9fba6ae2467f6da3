from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import CaptureError
from splatreel.capture.opening import open_capture
from tests.capture import folders


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    return folders.technicolor(tmp_path / "Painter")


def test_technicolor_cameras_and_frames(scene: Path) -> None:
    capture = open_capture(scene, held_out=["02"])
    assert ([c.name for c in capture.cameras], capture.frames, capture.fps) == (["00", "01", "02", "03"], 3, 30.0)
    for found, written in zip(capture.cameras, folders.cameras(), strict=True):
        np.testing.assert_allclose(found.viewmat, written.viewmat, atol=1e-6)
        np.testing.assert_allclose(found.K, written.K)
    assert [folders.which(image) for image in capture.read(1, 2, ["03"])[:, 0]] == [(3, 1), (3, 2)]


def test_camera_10_is_held_out_by_default(scene: Path) -> None:
    assert open_capture(scene).held_out == []
    parameters = scene / "cameras_parameters.txt"
    lines = parameters.read_text().splitlines()
    moved = [" ".join([*lines[1].split()[:9], str(c), "0", "4"]) for c in range(7)]
    parameters.write_text("\n".join([*lines, *moved]))
    for file in list(scene.glob("*_00.png")):
        for c in range(4, 11):
            (scene / f"{file.stem[:-2]}{c:02d}.png").write_bytes(file.read_bytes())
    assert open_capture(scene).held_out == ["10"]


def test_technicolor_sidecar_sets_held_out_and_rate(scene: Path) -> None:
    (scene / "splatreel.json").write_text('{"held_out": ["01"], "fps": 25}')
    capture = open_capture(scene, width=16, frames=(1, 3))
    assert (capture.held_out, capture.fps, capture.frames, capture.height) == (["01"], 25.0, 2, 12)
    assert folders.which(capture.read(0, 1, ["01"])[0, 0]) == (1, 1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda rows: rows.pop(), r"images of the cameras 00, 01, 02, 03 .*but 3 lines of cameras"),
        (lambda rows: rows[2].append("1"), r"cameras_parameters\.txt: camera 1 has 13 numbers, expected 12"),
        (lambda rows: rows[3].__setitem__(5, "much"), r"cameras_parameters\.txt: cannot be read"),
        (lambda rows: rows[4].__setitem__(0, "-40"), r"camera 3 is \[-40.0, .*its focal length must be positive"),
        (lambda rows: rows[4].__setitem__(0, "nan"), r"camera 3 is \[nan, "),
        (lambda rows: rows[4].__setitem__(5, "3"), r"its quaternion of length 1"),
    ],
)
def test_unusable_parameters_are_named(scene: Path, change, message: str) -> None:
    file = scene / "cameras_parameters.txt"
    rows = [line.split() for line in file.read_text().splitlines()]
    change(rows)
    file.write_text("\n".join(map(" ".join, rows)))
    with pytest.raises(CaptureError, match=message):
        open_capture(scene)


def test_missing_frame_is_named(scene: Path) -> None:
    (scene / "Painter_undist_00052_01.png").unlink()
    capture = open_capture(scene)
    assert capture.notes == ["01 has no images 52: left out of training for that camera only"]
    assert capture.missing(0, 3, ["00", "01"])[:, 1].tolist() == [False, True, False]


def test_unrelated_images_are_ignored(scene: Path) -> None:
    (scene / "Painter_undist_00051_00.png").rename(scene / "cover.png")
    capture = open_capture(scene)
    assert capture.notes == ["00 has no images 51: left out of training for that camera only"]
    assert folders.which(capture.read(0, 1, ["00"])[0, 0]) == (0, 1)
