import numpy as np

from splatreel.capture.median_images import median_images
from tests.evaluation.test_moving_pixels import FRAMES, SquareCapture


def test_median_image_shows_static_content() -> None:
    capture = SquareCapture()
    for image, value in zip(median_images(capture, ["cam01", "cam03"]), (10, 30), strict=True):
        assert image.dtype == np.uint8
        assert np.all(image == value)
    assert len(capture.asked) == 2 * 20
    assert (min(capture.asked), max(capture.asked)) == (0, FRAMES - 1)
