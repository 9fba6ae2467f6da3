from pathlib import Path

import numpy as np

from splatreel.capture.base import Capture
from splatreel.capture.median_images import median_images, moving_pixels
from tests.evaluation import scenes

FRAMES = 45
SIDE = 4


class SquareCapture(Capture):
    """Capture of a bright 4-pixel square that moves right by one pixel per frame, over a background that identifies the camera."""

    def __init__(self, frames: int = FRAMES) -> None:
        self.asked: list[int] = []
        super().__init__(Path("square"), scenes.cameras(), held_out=["cam00"], frame_range=(0, frames))

    def _read_into(self, out: np.ndarray, first: int, cameras: list[str]) -> None:
        self.asked += range(first, first + len(out))
        for t in range(len(out)):
            for c, name in enumerate(cameras):
                out[t, c] = 10 * int(name[3:])
                out[t, c, :SIDE, first + t : first + t + SIDE] = 200


def test_median_image_shows_static_content() -> None:
    capture = SquareCapture()
    for image, value in zip(median_images(capture, ["cam01", "cam03"]), (10, 30), strict=True):
        assert image.dtype == np.uint8
        assert np.all(image == value)
    assert len(capture.asked) == 2 * 20
    assert (min(capture.asked), max(capture.asked)) == (0, FRAMES - 1)


def test_moving_pixels_cover_the_moving_square() -> None:
    capture = SquareCapture()
    median = median_images(capture, ["cam02"])[0]
    expected = np.zeros((scenes.HEIGHT, scenes.WIDTH), bool)
    expected[:SIDE, 30 : 30 + SIDE] = True
    truth = capture.read(30, 1, ["cam02"])[0, 0].astype(np.float32) / 255
    np.testing.assert_array_equal(moving_pixels(truth, median), expected)


def test_moving_pixels_ignore_small_differences() -> None:
    median = np.full((2, 3, 3), 100, np.uint8)
    truth = np.full((2, 3, 3), 100 / 255, np.float32)
    truth[0, 1] += 7 / 255
    truth[1, 2, 0] -= 30 / 255  # one channel: 10 in the mean
    assert np.argwhere(moving_pixels(truth, median)).tolist() == [[1, 2]]


def test_moving_pixels_are_empty_for_one_frame() -> None:
    capture = SquareCapture(1)
    truth = capture.read(0, 1, ["cam00"])[0, 0].astype(np.float32) / 255
    assert not moving_pixels(truth, median_images(capture, ["cam00"])[0]).any()
