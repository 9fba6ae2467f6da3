"""Segmentation of a walking body of spheres, whose masks are known."""

import numpy as np
import pytest

from splatreel.segmentation.background import fit_background
from splatreel.segmentation.evidence import LIMIT, Agreement, ColorModel
from splatreel.segmentation.segmenter import SubjectModel, fit_subject, uncover
from splatreel.segmentation.smoothing import decide, without_specks
from tests.segmentation import scenes

SKIN = np.array([210, 140, 110])
PLACE = np.s_[20:50, 30:60]
"""Rows and columns of somebody who stands."""
HEIGHT, WIDTH = scenes.backdrop(0).shape[:2]


def film(standing: int, color: np.ndarray = SKIN, behind: np.ndarray | None = None) -> np.ndarray:
    """Return 20 samples of a room. Somebody of one color stands in the first samples, up to the number `standing`."""
    rng, room = np.random.default_rng(0), scenes.backdrop(0) if behind is None else behind
    samples = np.repeat(room[None].astype(np.float32), 20, 0)
    samples[(slice(0, standing), *PLACE)] = color
    return (samples + rng.normal(0, 1.5, samples.shape)).clip(0, 255).astype(np.uint8)


def known_colors(*subject: np.ndarray) -> ColorModel:
    """Return the colors of a subject, and those of the room."""
    model, room, none = ColorModel(), scenes.backdrop(0), np.zeros((HEIGHT, WIDTH), bool)
    model.add(room, none, ~none)
    for color in subject:
        model.add(np.broadcast_to(color, room.shape).astype(np.uint8), ~none, none)
    return model


def test_room_is_found_behind_somebody_who_stands_most_of_the_time() -> None:
    samples = film(standing=16)
    first = fit_background(samples)
    assert np.abs(first.image[PLACE] - SKIN).max() < 6
    found, taken = uncover(first, samples, known_colors(SKIN))
    inner = np.s_[22:48, 32:58]
    assert taken[inner].all()
    assert taken.sum() <= 30 * 30
    assert np.abs(found.image[inner] - scenes.backdrop(0)[inner]).max() < 6
    assert np.allclose(found.share[inner], 0.2, atol=0.06)


def test_somebody_who_stands_for_a_while_is_no_background() -> None:
    samples = film(standing=4)
    found, taken = uncover(fit_background(samples), samples, known_colors(SKIN))
    assert not taken.any()
    assert np.abs(found.image[PLACE] - scenes.backdrop(0)[PLACE]).max() < 6


def test_color_of_two_samples_is_no_background() -> None:
    samples = film(standing=18)
    _, taken = uncover(fit_background(samples), samples, known_colors(SKIN))
    assert not taken.any()


def test_dark_doorway_is_no_pair_of_trousers() -> None:
    """The doorway has a color of the subject, and somebody in another color stands in it for a while."""
    dark, shirt = np.array([20, 20, 20]), np.array([150, 150, 150])
    room = scenes.backdrop(0).copy()
    room[10:60, 20:70] = dark
    samples = film(standing=4, color=shirt, behind=room)
    _, taken = uncover(fit_background(samples), samples, known_colors(dark))
    assert not taken.any()


def test_colors_of_cameras_count_alike() -> None:
    few, many = known_colors(SKIN), known_colors(*[np.array([20, 20, 20])] * 9)
    both = ColorModel.merged([few, many])
    shown = np.broadcast_to(SKIN, (4, 4, 3)).astype(np.uint8)
    assert both.evidence(shown).min() > 1
    assert both.evidence(np.full((4, 4, 3), 20, np.uint8)).min() > 1
    assert many.evidence(shown).max() < 1


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
