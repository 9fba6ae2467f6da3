from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatreel.base.errors import CaptureError
from splatreel.capture.camera_images import CameraImages, same_shape
from splatreel.capture.files import LOCAL

SIDEWAYS = 6
"""Number in EXIF of images whose top is at the right."""


@pytest.fixture
def image(tmp_path: Path) -> Path:
    exif = Image.Exif()
    exif[0x112] = SIDEWAYS
    Image.fromarray(np.arange(36 * 64 * 3, dtype=np.uint8).reshape(36, 64, 3)).save(tmp_path / "a.png", exif=exif)
    return tmp_path / "a.png"


@pytest.mark.parametrize(
    ("size", "other"),
    [((618, 410), (4946, 3286)), ((1345, 1008), (2690, 2016)), ((620, 412), (4946, 3286)), ((64, 48), (64, 48))],
)
def test_rounded_sizes_have_one_shape(size: tuple[int, int], other: tuple[int, int]) -> None:
    assert same_shape(size, other)
    assert same_shape(other, size)
    assert not same_shape((size[0], size[1] + 5), other)
    assert not same_shape((size[1], size[0]), other)


@pytest.mark.parametrize("size", [(1920, 1088), (1440, 1080), (640, 480), (1080, 1920)])
def test_crops_and_other_shapes_differ(size: tuple[int, int]) -> None:
    assert not same_shape((1920, 1080), size)


@pytest.mark.parametrize("upright", [True, False])
@pytest.mark.parametrize("calibrated", [None, (36, 64), (64, 36), (72, 128), (100, 100)])
def test_calibration_decides_about_exif(image: Path, upright: bool, calibrated: tuple[int, int] | None) -> None:
    images = CameraImages({"a": image}, LOCAL, upright)
    obeyed = {(36, 64): True, (72, 128): True, (64, 36): False}.get(calibrated or (0, 0), upright)
    assert images.size("a", calibrated) == ((36, 64) if obeyed else (64, 36))
    out = np.empty((64, 36, 3) if obeyed else (36, 64, 3), np.uint8)
    images.read(out, "a", image)
    with Image.open(image) as stored:
        np.testing.assert_array_equal(out, np.rot90(np.asarray(stored), 3 if obeyed else 0))
    assert images.conversions() == [f"all cameras: images are {'' if obeyed else 'not '}turned {_reason(obeyed)}"]


def _reason(obeyed: bool) -> str:
    return "upright as EXIF says" if obeyed else "as EXIF says, as in COLMAP"


def test_later_image_of_another_size_is_refused(image: Path) -> None:
    Image.new("RGB", (36, 72)).save(image.with_name("b.png"))
    images = CameraImages({"a": image}, LOCAL, True)
    with pytest.raises(CaptureError, match=r"b\.png: is 36x72, the first image of its camera is 36x64"):
        images.read(np.empty((64, 36, 3), np.uint8), "a", image.with_name("b.png"))
