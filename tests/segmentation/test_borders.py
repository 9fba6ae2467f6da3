"""Opacity of border pixels."""

import cv2
import numpy as np
import pytest

from splatreel.capture.masks import LIKELY_GRAY, opacity_of_level
from splatreel.segmentation.background import Background
from splatreel.segmentation.borders import with_border_opacity
from tests.segmentation import scenes

FINE = 8
"""Samples of a pixel along each side."""


def coverage() -> np.ndarray:
    """Return how much of each pixel a disc fills, [H, W] float32 0..1."""
    fine = np.zeros((FINE * scenes.HEIGHT, FINE * scenes.WIDTH), np.float32)
    cv2.circle(fine, (400, 300), 150, 1.0, -1)
    return cv2.resize(fine, (scenes.WIDTH, scenes.HEIGHT), interpolation=cv2.INTER_AREA)


def background() -> Background:
    image = scenes.backdrop(0).astype(np.float32)
    noise, share = np.full(image.shape[:2], 1.5, np.float32), np.ones(image.shape[:2], np.float32)
    return Background(image, noise, share, share > 0, floor=2.0)


def mixed(cover: np.ndarray, color: tuple[int, int, int] = (230, 30, 40)) -> np.ndarray:
    noise = np.random.default_rng(0).normal(0, 1.5, (*cover.shape, 3))
    share = cover[..., None]
    return (share * color + (1 - share) * background().image + noise).round().clip(0, 255).astype(np.uint8)


def white(mask: np.ndarray) -> np.ndarray:
    return np.where(mask, np.uint8(255), np.uint8(0))


@pytest.mark.parametrize(("grown", "largest"), [(-1, 0.15), (0, 0.06), (1, 0.15)])
def test_opacity_is_what_the_subject_fills_of_each_pixel(grown: int, largest: float) -> None:
    """Masks that are wrong by a pixel are corrected. A mask that is too wide has mixed pixels inside."""
    cover = coverage()
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    mask = cover >= 0.5
    if grown:
        mask = (cv2.dilate if grown > 0 else cv2.erode)(mask.astype(np.uint8), cross) > 0
    found = opacity_of_level(with_border_opacity(white(mask), mixed(cover), background())) / 255
    border = (cover > 0) & (cover < 1)
    assert np.abs(found - cover)[border].mean() < largest < np.abs(mask - cover)[border].mean()
    assert np.abs(found - cover)[~border].max() < 0.1


def test_mask_decides_where_the_subject_has_the_color_of_the_background() -> None:
    cover = coverage()
    mask = white(cover >= 0.5)
    wall = background()
    wall.image[:] = 120
    image = np.full((*cover.shape, 3), 121, np.uint8)
    found = opacity_of_level(with_border_opacity(mask, image, wall)) / 255
    assert np.array_equal(found >= 0.5, mask == 255)


def test_doubts_and_pixels_before_an_unknown_background_stay() -> None:
    cover = coverage()
    mask = white(cover >= 0.5)
    mask[:36][mask[:36] == 255] = LIKELY_GRAY
    unknown = background()
    unknown.known[:, :48] = False
    found = with_border_opacity(mask, mixed(cover), unknown)
    assert np.array_equal(found[:, :48], mask[:, :48])
    assert np.array_equal(found == LIKELY_GRAY, mask == LIKELY_GRAY)
    assert ((found[40:, 48:] > 0) & (found[40:, 48:] < 255)).any()
