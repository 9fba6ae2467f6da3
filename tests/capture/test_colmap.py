import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatreel.capture.opening import open_capture
from splatreel.errors import CaptureError, MissingDependencyError
from tests.capture import folders


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    pytest.importorskip("pycolmap")
    return folders.colmap(tmp_path / "scene")


def test_names_are_matched_without_their_extension(scene: Path) -> None:
    capture = open_capture(scene)
    assert [c.name for c in capture.cameras] == [f"view/cam{c:02d}" for c in range(4)]
    assert capture.held_out == ["view/cam00"]
    assert (capture.frames, capture.width, capture.height) == (1, 32, 24)
    assert folders.which(capture.read(0, 1, ["view/cam02"])[0, 0]) == (2, 0)


def test_cameras_and_points_are_those_of_the_model(scene: Path) -> None:
    capture = open_capture(scene)
    for found, written in zip(capture.cameras, folders.cameras(), strict=True):
        np.testing.assert_allclose(found.viewmat, written.viewmat, atol=1e-5)
        np.testing.assert_allclose(found.K, written.K, atol=1e-5)
    np.testing.assert_allclose(capture.points, [[0.5, -0.25, 1], [0, 0, 0]])
    np.testing.assert_allclose(capture.point_colors, [[1, 0.2, 0], [0, 1, 0.4]], atol=1e-6)


def test_a_binary_model_says_the_same(scene: Path, tmp_path: Path) -> None:
    import pycolmap

    text = open_capture(scene)
    model = scene / "sparse" / "0"
    reconstruction = pycolmap.Reconstruction(str(model))
    shutil.rmtree(model)
    model.mkdir()
    reconstruction.write_binary(str(model))
    assert open_capture(scene).fingerprint() == text.fingerprint()


def test_scale_counts_from_the_size_of_the_model(scene: Path) -> None:
    assert open_capture(scene, scale=0.25).width == 16
    assert open_capture(scene, width=16).height == 12


def test_the_smallest_images_that_are_large_enough_are_read(scene: Path) -> None:
    shutil.copytree(scene / "images_2", scene / "images_4")
    for path in (scene / "images_4").rglob("*.jpg"):
        Image.new("RGB", (16, 12), (255, 0, 0)).save(path)
    assert open_capture(scene).width == 32
    assert open_capture(scene, width=16).read(0, 1, ["view/cam01"])[0, 0, 6, 8, 0] > 240
    assert folders.which(open_capture(scene, width=20).read(0, 1, ["view/cam01"])[0, 0]) == (1, 0)


def test_lens_distortion_is_refused_with_the_remedy(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    scene = folders.colmap(tmp_path / "scene", "SIMPLE_RADIAL", "80 32 24 0.1")
    with pytest.raises(CaptureError, match=r"camera 1 is SIMPLE_RADIAL .*0\.1.*image_undistorter"):
        open_capture(scene)


@pytest.mark.parametrize(
    ("model", "params"),
    [("SIMPLE_PINHOLE", "80 32 24"), ("SIMPLE_RADIAL", "80 32 24 0"), ("OPENCV", "80 80 32 24 0 0 0 0")],
)
def test_models_that_do_not_distort_are_pinholes(tmp_path: Path, model: str, params: str) -> None:
    pytest.importorskip("pycolmap")
    capture = open_capture(folders.colmap(tmp_path / "scene", model, params))
    np.testing.assert_allclose(capture.cameras[1].K, folders.cameras()[1].K, atol=1e-5)


def test_a_missing_image_is_named(scene: Path) -> None:
    (scene / "images_2" / "view" / "cam02.jpg").unlink()
    with pytest.raises(CaptureError, match="images_2 lacks 1 of 4, the first is view/cam02"):
        open_capture(scene)


def test_a_model_that_cannot_be_read_is_named(scene: Path) -> None:
    (scene / "sparse" / "0" / "images.txt").unlink()
    with pytest.raises(CaptureError, match="cannot be read as a COLMAP model"):
        open_capture(scene)


def test_without_pycolmap_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    with pytest.raises(MissingDependencyError, match=r"splatreel\[recon\]"):
        open_capture(folders.colmap(tmp_path / "scene"))
