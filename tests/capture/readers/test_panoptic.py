import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import CaptureError
from splatreel.capture.opening import open_capture
from tests.capture import folders


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    return folders.panoptic(tmp_path / "basketball")


def test_panoptic_holds_out_test_meta_cameras(scene: Path) -> None:
    capture = open_capture(scene)
    assert [c.name for c in capture.cameras] == ["1", "2", "10", "12"]
    assert capture.held_out == ["10"]
    assert (capture.frames, capture.fps, capture.points) == (5, 30.0, None)
    np.testing.assert_allclose(capture.camera("12").viewmat, folders.cameras()[2].viewmat)
    np.testing.assert_allclose(capture.camera("10").viewmat, folders.cameras()[3].viewmat)


def test_panoptic_images_are_read(scene: Path) -> None:
    images = open_capture(scene, frames=(1, 5)).read(1, 2, ["10", "2"])
    assert [[folders.which(image) for image in step] for step in images] == [[(3, 2), (1, 2)], [(3, 3), (1, 3)]]


def test_panoptic_images_are_resized(scene: Path) -> None:
    capture = open_capture(scene, width=16)
    assert capture.read(0, 1, ["1"]).shape == (1, 1, 12, 16, 3)
    np.testing.assert_allclose(capture.camera("1").K, [[20, 0, 8], [0, 20, 6], [0, 0, 1]])


def test_missing_test_meta_holds_out_nothing(scene: Path) -> None:
    (scene / "test_meta.json").unlink()
    assert open_capture(scene).held_out == []


def spoil(scene: Path, change: Callable[[dict], object], file: str = "train_meta.json") -> None:
    meta = json.loads((scene / file).read_text())
    change(meta)
    (scene / file).write_text(json.dumps(meta))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: m.pop("k"), r"train_meta\.json: is not a Panoptic Sports description .*'k'"),
        (lambda m: m.update(k=m["k"][:3]), r"train_meta\.json: k has shape \(3, 3, 3, 3\), expected \(5, 3, 3, 3\)"),
        (lambda m: m.update(w2c=[[[1, 2, 3]] * 3] * 5), r"train_meta\.json: w2c has shape"),
        (lambda m: m["w2c"][3][1][0].__setitem__(3, 9.0), r"w2c of camera 2 changes over time"),
        (lambda m: [step[1][0].__setitem__(3, float("nan")) for step in m["w2c"]], "Camera '2': viewmat holds NaN"),
        (
            lambda m: [step[1].__setitem__(2, [-x for x in step[1][2]]) for step in m["w2c"]],
            r"train_meta\.json: w2c of camera 2 is .*it mirrors",
        ),
        (lambda m: [c.__setitem__(0, 10) for c in m["cam_id"]], "a camera is listed twice"),
        (lambda m: [m[key].pop() for key in ("k", "w2c", "fn", "cam_id")], r"unequal frame counts .*'10': 5"),
    ],
)
def test_invalid_meta_file_names_the_fault(scene: Path, change: Callable[[dict], object], message: str) -> None:
    spoil(scene, change)
    with pytest.raises(CaptureError, match=message):
        open_capture(scene)


def test_meta_file_without_json_is_named(scene: Path) -> None:
    (scene / "test_meta.json").write_text("{")
    with pytest.raises(CaptureError, match=r"test_meta\.json: .* should be a Panoptic"):
        open_capture(scene)


def test_a_missing_image_is_named(scene: Path) -> None:
    (scene / "ims" / "2" / "000003.png").unlink()
    capture = open_capture(scene)
    assert capture.notes == ["2 has no images 3: left out of training for that camera only"]
    assert capture.missing(0, 5, ["1", "2"])[:, 1].tolist() == [False, False, False, True, False]


def test_a_truncated_image_is_named(scene: Path) -> None:
    path = scene / "ims" / "2" / "000003.png"
    path.write_bytes(path.read_bytes()[:40])
    with pytest.raises(CaptureError, match=r"000003\.png: cannot be read as an image"):
        open_capture(scene).read(3, 1, ["2"])
