"""Smooth decisions."""

import numpy as np

from splatreel.segmentation.smoothing import without_halo


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
