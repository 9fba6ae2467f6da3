"""Image sizes of training and their durations."""

from dataclasses import replace

import numpy as np
import pytest

from splatreel.method.train.render import View
from splatreel.method.train.training_images import TrainingImages
from tests.method.scenes import ring


def make_images(width: int, height: int) -> TrainingImages:
    images = np.full((1, 1, height, width, 3), 100, np.uint8)
    return TrainingImages(images, [View.of(ring(1, width=width, height=height)[0])], 0.1, 4.0)


def sizes(width: int, height: int, coarse: float, afforded: float) -> list[tuple[int, int]]:
    """Return the iteration of 1000 at which each size ends, and its width."""
    return [(end, shown.pixels.shape[3]) for end, shown in make_images(width, height).sizes(1000, coarse, afforded)]


def test_sizes_of_small_images_end_at_full_size():
    assert sizes(100, 80, 0.25, 0.4) == [(250, 50), (1000, 100)]
    assert sizes(100, 80, 0.0, 0.4) == [(1000, 100)]


def test_sizes_of_large_images_share_pixels_equally():
    """8,000 pixels with a limit of 2,000: full size in a quarter of the iterations, then half size and coarse sizes."""
    assert sizes(100, 80, 0.25, 0.002) == [(250, 25), (750, 50), (1000, 100)]
    assert sizes(100, 80, 0.0, 0.002) == [(750, 50), (1000, 100)]
    assert sizes(100, 80, 0.25, 0.0005) == [(250, 12), (688, 25), (938, 50), (1000, 100)]


def test_sizes_without_limit_use_full_size():
    assert sizes(100, 80, 0.25, 0.0) == [(250, 50), (1000, 100)]


@pytest.mark.parametrize("width", [101, 100])
def test_halved_views_project_to_half_pixels(width: int):
    shown = make_images(width, 80).halved()
    assert shown.pixels.shape[2:4] == (40, 50)
    assert (shown.pixels == 100).all()
    assert (shown.views[0].width, shown.views[0].height) == (50, 40)


def test_halved_pixel_is_unknown_if_one_of_its_four_is() -> None:
    images, unknown = make_images(7, 5), np.zeros((1, 1, 5, 7), bool)
    unknown[0, 0, 1, 3] = unknown[0, 0, 4, 0] = unknown[0, 0, 0, 6] = True
    small = replace(images, unknown=unknown).halved()
    assert small.unknown is not None
    assert small.unknown[0, 0].tolist() == [[False, True, False], [False] * 3], "odd rows and columns are cut off"
    assert small.pixels.shape == (1, 1, 2, 3, 3)


def test_unknown_pixels_of_a_target_repeat_the_drawing() -> None:
    images, unknown = make_images(4, 3), np.zeros((1, 1, 3, 4), bool)
    unknown[0, 0, 1, 2] = True
    drawn, gain = np.full((3, 4, 3), 0.5, np.float32), np.array([1, 0.5, 4], np.float32)
    target = replace(images, unknown=unknown).target(0, 0, drawn, gain)
    assert target.dtype == np.uint8
    assert target[1, 2].tolist() == [128, 64, 255]
    target[1, 2] = 100
    assert (target == 100).all()
    assert np.shares_memory(images.target(0, 0, drawn, None), images.pixels)
