from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatreel.capture.lens import common_size
from splatreel.capture.opening import open_capture
from splatreel.scene.camera import Camera
from tests.capture import folders


@pytest.mark.parametrize(
    ("sizes", "expected"),
    [
        ([(192, 256), (256, 192), (256, 192)], (256, 192)),
        ([(192, 256), (192, 256), (1920, 1440), (1024, 768), (256, 192)], (1920, 1440)),  # shapes count, not sizes
        ([(1920, 1080), (1440, 1080)], (1920, 1080)),  # a tie
        ([(100, 300), (200, 100), (200, 150)], (200, 150)),  # a tie in which the middle shape loses the least
    ],
)
def test_the_most_common_shape_decides(sizes: list[tuple[int, int]], expected: tuple[int, int]) -> None:
    assert common_size(sizes) == expected


def mixed(folder: Path, upright: int, count: int = 4) -> Path:
    """Write a Neu3DV folder of images in which one camera is upright; colors encode the direction of each pixel."""
    folder.mkdir()
    views = []
    for c, view in enumerate(folders.cameras(count)):
        width, height = (24, 32) if c == upright else (32, 24)
        K = np.array([[40.0, 0, width / 2], [0, 40.0, height / 2], [0, 0, 1]])
        views.append(Camera(view.name, view.viewmat, K, width, height))
        x, y = np.meshgrid(np.arange(width) + 0.5 - width / 2, np.arange(height) + 0.5 - height / 2)
        image = np.stack([128 + 5 * x, 128 + 5 * y, np.full(x.shape, 7)], 2).round().astype(np.uint8)
        (folder / view.name).mkdir()
        Image.fromarray(image).save(folder / view.name / "0000.png")
    np.save(folder / "poses_bounds.npy", folders.llff(views))
    return folder


@pytest.mark.parametrize("upright", [0, 2])
def test_an_upright_camera_is_cropped_and_the_others_are_not(tmp_path: Path, upright: int) -> None:
    pytest.importorskip("cv2")
    capture = open_capture(mixed(tmp_path / "scene", upright))
    assert (capture.width, capture.height) == (32, 24)
    name = capture.cameras[upright].name
    assert [note for note in capture.notes if "crop" in note] == [
        f"images are cropped to the shape of most cameras' images (32x24): {name} by 44 %"
    ]
    for camera in capture.cameras:
        image = capture.read(0, 1, [camera.name])[0, 0].astype(float)
        x, y = np.meshgrid(np.arange(32) + 0.5 - camera.K[0, 2], np.arange(24) + 0.5 - camera.K[1, 2])
        expected = 128 + 5 * 40 * np.stack([x / camera.K[0, 0], y / camera.K[1, 1]], 2)
        assert np.abs(image[2:-2, 2:-2, :2] - expected[2:-2, 2:-2]).max() < 4, camera.name


def test_an_upright_camera_that_is_left_out_crops_nothing(tmp_path: Path) -> None:
    capture = open_capture(mixed(tmp_path / "scene", 0), leave_out=["cam00"])
    assert not [note for note in capture.notes if "crop" in note]


@pytest.mark.parametrize("order", [[0, 1, 2, 3], [3, 2, 1, 0]])
def test_colmap_models_keep_the_shape_of_most_cameras(tmp_path: Path, order: list[int]) -> None:
    pytest.importorskip("pycolmap")
    pytest.importorskip("cv2")
    scene = folders.colmap(tmp_path / "scene", "PINHOLE", "80 80 32 24")
    model = scene / "sparse/0"
    lines = [line for line in (model / "images.txt").read_text().splitlines() if line and not line.startswith("#")]
    upright = order[0]
    (model / "cameras.txt").write_text("1 PINHOLE 64 48 80 80 32 24\n2 PINHOLE 48 64 80 80 24 32\n")
    rows = []
    for line in lines:
        words = line.split()
        if len(words) == 10 and words[9].startswith(f"view/cam{upright:02d}"):
            words[8] = "2"
        rows.append(" ".join(words))
    (model / "images.txt").write_text("\n\n".join(rows) + "\n\n")
    for file in (scene / "images_2").rglob("*.jpg"):
        size = (48, 64) if f"cam{upright:02d}" in file.stem else (64, 48)
        Image.new("RGB", size, (90, 90, 90)).save(file)
    capture = open_capture(scene)
    assert (capture.width, capture.height) == (64, 48)
    assert [note for note in capture.notes if "cropped" in note] == [
        f"images are cropped to the shape of most cameras' images (64x48): view/cam{upright:02d} by 44 %"
    ]


def test_crops_by_undistortion_are_reported(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    pytest.importorskip("cv2")
    scene = folders.colmap(tmp_path / "scene", "SIMPLE_RADIAL", "80 32 24 -0.4")
    for file in (scene / "images_2").rglob("*.jpg"):
        Image.new("RGB", (64, 48), (90, 90, 90)).save(file)
    [note] = [note for note in open_capture(scene).notes if "cropped" in note]
    assert note.startswith("images are cropped to remove the lens distortion without empty borders: view/cam00 by ")
