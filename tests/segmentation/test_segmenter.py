"""Segmentation of a walking body of spheres, whose masks are known."""

import numpy as np
import pytest

from splatreel.segmentation.agreement import Agreement
from splatreel.segmentation.colors import ColorModel
from splatreel.segmentation.evidence import LIMIT
from splatreel.segmentation.segmenter import SubjectModel, fit_subject
from splatreel.segmentation.smoothing import decide, without_specks
from tests.segmentation import scenes


@pytest.fixture(scope="module")
def model() -> SubjectModel:
    return fit_subject(scenes.ring(), scenes.film(12)[0])


def test_masks_show_the_body_and_not_its_shadow(model: SubjectModel) -> None:
    images, truth = scenes.film(8)
    found = model.masks(images[5:8]) > 127
    assert scenes.overlap(found, truth[5:8]) > 0.7
    assert found[truth[5:8]].mean() > 0.95
    shadow = np.abs(images[5:8].astype(int) - np.stack([scenes.backdrop(c) for c in range(6)])).max(-1) > 12
    assert found[shadow & ~truth[5:8]].mean() < 0.6


def test_packed_model_segments_alike(model: SubjectModel) -> None:
    again = SubjectModel.unpack(scenes.ring(), model.pack(), 0.0)
    images = scenes.film(2)[0]
    assert np.array_equal(again.masks(images), model.masks(images))


def test_clean_plate_finds_a_body_that_never_moves() -> None:
    images, truth = scenes.film(4, at=(0.3, -0.2))
    plates = [scenes.backdrop(c)[None] for c in range(scenes.CAMERAS)]
    found = fit_subject(scenes.ring(), images, plates).masks(images[:1]) > 127
    assert scenes.overlap(found, truth[:1]) > 0.65
    without = fit_subject(scenes.ring(), images)
    assert not (without.masks(images[:1]) > 127).any()
    assert max(without.moving_shares) == 0


def test_other_views_support_the_body_and_nothing_else() -> None:
    views, (_, truth) = scenes.ring(), scenes.film(1)
    support = Agreement(views).support(np.where(truth[0], LIMIT, -LIMIT).astype(np.float32))
    assert (support[truth[0]] > 0).mean() > 0.97
    assert (support[~truth[0]] < 0).mean() > 0.8


def test_body_that_one_camera_alone_shows_is_not_supported() -> None:
    evidence = np.full((scenes.CAMERAS, scenes.HEIGHT, scenes.WIDTH), -LIMIT, np.float32)
    evidence[0, 20:40, 20:40] = LIMIT
    assert (Agreement(scenes.ring()).support(evidence)[0] < 0).all()


def test_decisions_follow_borders_of_the_image() -> None:
    image = np.full((40, 60, 3), 200, np.uint8)
    image[10:30, 20:40] = 40, 90, 160
    odds = np.full((40, 60), -1.0, np.float32)
    odds[10:30, 20:40] = np.where(np.random.default_rng(0).random((20, 20)) < 0.7, 2, -2)
    found = decide(image, odds) > 0
    assert found[12:28, 22:38].mean() > 0.9
    assert not found[:8].any()
    assert not found[:, :17].any()


def test_supported_holes_are_filled_and_stray_parts_removed() -> None:
    mask, support = np.zeros((100, 100), bool), np.full((100, 100), -1.0)
    mask[20:60, 20:60], support[20:60, 20:60] = True, 2
    mask[30:33, 30:33] = mask[50:53, 50:53] = False
    support[50:53, 50:53] = -1
    mask[90, 90] = True
    mask[70:80, 70:80], support[70:80, 70:80] = True, 0.5  # a reflection, which other views neither see nor deny
    found = without_specks(mask, support)
    assert found[30:33, 30:33].all()
    assert not found[50:53, 50:53].any()
    assert not found[90, 90]
    assert not found[70:80, 70:80].any()


def test_colors_tell_the_subject_from_its_surroundings() -> None:
    image = np.full((20, 20, 3), (180, 170, 150), np.uint8)
    image[:, :10] = 40, 60, 160
    subject = np.zeros((20, 20), bool)
    subject[:, :8] = True
    colors = ColorModel()
    assert not colors.evidence(image).any()
    colors.add(image, subject, ~subject & (np.arange(20) > 12))
    assert (colors.evidence(image)[:, :9] > 1).all()
    assert (colors.evidence(image)[:, 11:] < -1).all()
