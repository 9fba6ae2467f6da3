import json
from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import CaptureError
from splatreel.base.progress import Silent
from splatreel.capture.base import Request
from splatreel.capture.conversion import convert_capture
from splatreel.capture.opening import open_capture
from splatreel.capture.readers.colmap import ColmapCapture
from tests.capture import blobs, folders
from tests.capture.readers import test_transforms
from tests.capture.readers.calibrations import test_metashape
from tests.files import contents

pytest.importorskip("pycolmap")
pytest.importorskip("cv2")


def test_every_layout_becomes_easyvolcap_and_colmap(tmp_path: Path) -> None:
    """The same frames, and a second conversion writes the same bytes."""
    source = open_capture(folders.panoptic(tmp_path / "scene"), frames=(1, 4))
    names = [camera.name for camera in source.cameras]
    assert convert_capture(source, tmp_path / "out", "png", Silent()) == dict(zip(names, names, strict=True))
    frames = source.read(0, 3, names)
    for found in (open_capture(tmp_path / "out"), ColmapCapture(tmp_path / "out", Request())):
        assert (found.frames, found.fps, found.held_out) == (3, 30.0, ["10"])
        assert len(found.cameras) == len(names)
        for camera in source.cameras:
            np.testing.assert_allclose(found.camera(camera.name).viewmat, camera.viewmat, atol=1e-6)
            np.testing.assert_allclose(found.camera(camera.name).K, camera.K, rtol=1e-6)
        assert np.array_equal(found.read(0, 3, names), frames)
    convert_capture(open_capture(tmp_path / "out"), tmp_path / "again", "png", Silent())
    assert contents(tmp_path / "again") == contents(tmp_path / "out")


def test_lenses_are_removed_and_points_kept(tmp_path: Path) -> None:
    (tmp_path / "scene").mkdir()
    source = open_capture(test_metashape.write(tmp_path / "scene", test_metashape.FRAME, component=""))
    source.points, source.point_colors = np.array([[0, 0.5, 1]], np.float32), np.array([[1, 0, 0.2]], np.float32)
    renamed = convert_capture(source, tmp_path / "out", "png", Silent())
    assert renamed["cam0.JPG"] == "cam0_JPG"
    for found in (open_capture(tmp_path / "out"), ColmapCapture(tmp_path / "out", Request(held_out=[]))):
        assert blobs.errors(found).max() < 0.15
    assert found.points is not None
    assert found.point_colors is not None
    np.testing.assert_allclose(found.points, source.points)
    np.testing.assert_allclose(found.point_colors, source.point_colors, atol=1e-6)


def test_gaps_stay_gaps(tmp_path: Path) -> None:
    scene = test_transforms.timed(tmp_path / "scene")
    meta = json.loads((scene / "transforms.json").read_text())
    del meta["frames"][8]  # the second time of camera 1
    (scene / "transforms.json").write_text(json.dumps(meta))
    source = open_capture(scene)
    convert_capture(source, tmp_path / "out", "png", Silent())
    names = [camera.name for camera in source.cameras]
    missing = open_capture(tmp_path / "out").missing(0, 3, names)
    assert missing.sum() == 1
    assert np.array_equal(missing, source.missing(0, 3, names))


def test_jpeg_is_close(tmp_path: Path) -> None:
    source = open_capture(folders.panoptic(tmp_path / "scene"))
    convert_capture(source, tmp_path / "out", "jpg", Silent())
    assert folders.which(open_capture(tmp_path / "out").read(4, 1, ["12"])[0, 0]) == (2, 4)
    assert json.loads((tmp_path / "out" / "splatreel.json").read_text()) == {"fps": 30.0, "held_out": ["10"]}


def test_existing_folders_and_equal_names_are_refused(tmp_path: Path) -> None:
    source = open_capture(folders.panoptic(tmp_path / "scene"))
    with pytest.raises(CaptureError, match="scene: exists already"):
        convert_capture(source, tmp_path / "scene", "jpg", Silent())
    scene = open_capture(folders.technicolor(tmp_path / "other"))
    object.__setattr__(scene.cameras[0], "name", "a b")
    object.__setattr__(scene.cameras[1], "name", "a.b")
    with pytest.raises(CaptureError, match="cameras would have equal names"):
        convert_capture(scene, tmp_path / "out", "jpg", Silent())
    assert not (tmp_path / "out").exists()
