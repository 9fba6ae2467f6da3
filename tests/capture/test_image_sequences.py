"""Images of cameras in the order of their numbers, which have no gaps."""

from collections.abc import Callable
from pathlib import Path

import pytest

from splatreel.capture.opening import open_capture
from splatreel.errors import CaptureError
from tests.capture import folders
from tests.capture.growing.recorder import Recorder


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    pytest.importorskip("cv2", reason="reads what OpenCV writes")
    return folders.easyvolcap(tmp_path / "scene", frames=6)


def rename(scene: Path, name: Callable[[int], str]) -> None:
    for file in sorted((scene / "images").rglob("*.png")):
        file.rename(file.with_name(name(int(file.stem))))


def test_numbers_need_no_zeros(scene: Path) -> None:
    rename(scene, lambda number: f"image{2 * number + 7}.png")
    capture = open_capture(scene)
    assert [folders.which(image)[1] for image in capture.read(0, 6, ["02"])[:, 0]] == list(range(6))


def test_missing_images_are_named_though_all_cameras_have_as_many(scene: Path) -> None:
    for camera, number in (("00", 4), ("01", 3), ("02", 2), ("03", 4)):
        (scene / "images" / camera / f"{number:06}.png").unlink()
    with pytest.raises(CaptureError, match=r"images/00: .*after 000003\.png: the next one is 000005\.png.*0:4"):
        open_capture(scene)
    with pytest.raises(CaptureError, match=r"images/01: .*after 000002\.png"):
        open_capture(scene, frames=(0, 4))
    frames = open_capture(scene, frames=(0, 2)).read(0, 2, ["00", "02"])
    assert [[folders.which(image)[1] for image in images] for images in frames] == [[0, 0], [1, 1]]


def test_frame_that_is_there_twice_is_named(scene: Path) -> None:
    (scene / "images" / "01" / "3.png").write_bytes((scene / "images" / "01" / "000003.png").read_bytes())
    with pytest.raises(CaptureError, match=r"images/01/.*3\.png: frame 3 is there twice"):
        open_capture(scene)


def test_names_without_numbers_are_in_order_of_names(scene: Path) -> None:
    rename(scene, lambda number: f"{'abcdef'[number]}.png")
    assert folders.which(open_capture(scene).read(3, 1, ["01"])[0, 0]) == (1, 3)


def test_technicolor_frame_that_all_cameras_lack_is_named(tmp_path: Path) -> None:
    scene = folders.technicolor(tmp_path / "Painter", frames=4)
    for file in scene.glob("*_00052_*.png"):
        file.unlink()
    with pytest.raises(CaptureError, match=r"after Painter_undist_00051_00\.png: the next one is .*_00053_00\.png"):
        open_capture(scene)


def test_missing_file_of_a_numbered_video_is_named(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "show", "segments")
    recorder.write(16)
    recorder.end()
    name = recorder.views[2].name
    (recorder.folder / name / "000002.mp4").unlink()
    with pytest.raises(CaptureError, match=rf"{name}/000002\.mp4: is missing, though files up to 000003\.mp4.*0:8"):
        open_capture(recorder.folder)
    assert open_capture(recorder.folder, frames=(0, 8)).frames == 8
