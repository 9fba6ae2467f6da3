"""Smooth decisions."""

import numpy as np

from splatreel.capture.masks import LIKELY_GRAY, UNLIKELY_GRAY
from splatreel.segmentation.smoothing import with_doubts, without_halo


def test_border_pixels_that_mostly_show_the_background_are_removed() -> None:
    body = np.zeros((40, 60), bool)
    body[10:30, 20:40] = True
    difference = np.where(body, np.float32(60), np.float32(2))
    mask = body.copy()
    mask[9:31, 19:41] = True
    difference[mask & ~body] = 20
    assert (without_halo(mask, difference) == body).all()


def test_border_that_differs_as_much_as_the_body_stays() -> None:
    mask = np.zeros((40, 60), bool)
    mask[10:30, 20:] = True
    difference = np.where(mask, np.float32(50), np.float32(2))
    difference[18:22, 30:34] = 200
    assert (without_halo(mask, difference) == mask).all()


def test_mask_before_an_unknown_background_stays() -> None:
    mask = np.zeros((40, 60), bool)
    mask[10:30, 20:40] = True
    difference = np.full(mask.shape, np.inf, np.float32)
    difference[:, 30:] = 20
    assert (without_halo(mask, difference) == mask).all()


def test_pixels_that_the_image_and_other_views_judge_differently_are_in_doubt() -> None:
    mask = np.zeros((40, 320), bool)
    mask[10:30, 20:40] = True
    own = np.where(mask, np.float32(3), np.float32(-3))
    support = np.full(mask.shape, -3, np.float32)
    expected = np.where(mask, np.uint8(255), np.uint8(0))
    own[12:16, 24:30] = -3  # a shirt like the wall, which other views show
    expected[12:16, 24:30] = LIKELY_GRAY
    own[20:26, 40:46] = support[20:26, 40:46] = 0.5  # a shirt like the wall, whose image differs a little
    expected[20:26, 40:46] = UNLIKELY_GRAY
    own[22, 43] = -3  # a pixel that shows the color of the wall
    for mixed in (
        (slice(10, 18), 40),
        (slice(0, 2), slice(100, 110)),
    ):  # a thin border, and a place that no body is near
        own[mixed] = support[mixed] = 0.5
    assert np.array_equal(with_doubts(mask, own, support), expected)
