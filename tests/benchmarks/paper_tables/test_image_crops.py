from pathlib import Path

import numpy as np
import pytest

from paper_tables.image_crops import LABEL, SIDE, Crop, anywhere, fast, find_crop, new, strip, truth_of
from splatreel.capture.base import Capture
from splatreel.scene.camera import Camera
from tests.evaluation import scenes


@pytest.fixture
def capture(tmp_path: Path) -> Capture:
    return scenes.capture(tmp_path)


def test_crop_is_where_the_error_is_largest(capture: Capture) -> None:
    def wrong(frame: int, camera: Camera) -> np.ndarray:
        image = truth_of(capture, frame, camera.name)
        if (frame, camera.name) == (3, "cam03"):
            image[10:20, 40:50] = 1 - image[10:20, 40:50]
        return image

    crop = find_crop(capture, [wrong], anywhere)
    assert crop is not None
    assert (crop.camera, crop.frame, crop.side) == ("cam03", 3, 14)
    assert crop.top <= 10 < 20 <= crop.top + crop.side
    assert crop.left <= 40 < 50 <= crop.left + crop.side
    assert crop.of(wrong(3, capture.camera("cam03"))).shape == (14, 14, 3)
    assert find_crop(capture, [wrong], anywhere, frames=[1]) is None
    inverted = find_crop(capture, [wrong], anywhere, frames=[3], reference=wrong)
    assert inverted is None


def test_weights_are_zero_where_nothing_moves(capture: Capture) -> None:
    static = np.abs(truth_of(capture, 0, "cam00") - truth_of(capture, 4, "cam00")).max(-1) == 0
    assert fast(capture, 4, "cam00").max() > 0.1
    assert (new(capture, 4, "cam00")[static] == 0).all()
    assert not new(capture, 0, "cam00").any()


def test_strip_has_a_crop_and_a_name_for_each_image() -> None:
    sheet = strip({"truth": np.zeros((10, 10, 3), np.float32), "ours": np.full((10, 10, 3), 200, np.uint8)})
    assert sheet.shape == (LABEL + SIDE, 2 * SIDE, 3)
    assert (sheet[LABEL:, :SIDE] == 0).all()
    assert (sheet[LABEL:, SIDE:] == 200).all()
    assert (sheet[:LABEL] == 255).mean() > 0.5
    assert (sheet[:LABEL] < 128).any()


def test_crops_are_cut_by_rows_and_columns() -> None:
    image = np.arange(6 * 8 * 3).reshape(6, 8, 3)
    np.testing.assert_array_equal(Crop("a", 0, 1, 3, 4).of(image), image[1:5, 3:7])
