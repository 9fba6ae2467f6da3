"""Evidence of one image."""

import numpy as np

from splatreel.segmentation.background import fit_background
from splatreel.segmentation.evidence import MAX_FLOOR, MIN_FLOOR, difference, subject_evidence, with_floor
from tests.segmentation import scenes
from tests.segmentation.test_background import noisy


def test_body_of_almost_the_color_of_a_still_background_is_found() -> None:
    wall = np.full_like(scenes.backdrop(0), 150)
    film = np.stack([noisy(wall, t, 1.0) for t in range(12)])
    shown = noisy(wall, 20, 1.0)
    shown[20:50, 30:60] += 11  # brighter, so no shadow
    background = fit_background(film)
    assert (subject_evidence(shown, background)[22:48, 32:58] < 0).all()
    found = subject_evidence(shown, with_floor(background, film))
    assert (found[22:48, 32:58] > 0).mean() > 0.95
    assert (found[:15] < 0).all()


def test_floor_follows_the_changes_of_light() -> None:
    wall = np.full_like(scenes.backdrop(0), 150)
    still = np.stack([noisy(wall, t, 1.0) for t in range(12)])
    background = fit_background(still)
    flickering = still.copy()
    for t in range(12):  # patches too small for a change of exposure
        patches = np.random.default_rng(t).normal(0, 7, (9, 12)).repeat(8, 0).repeat(8, 1)[..., None]
        flickering[t] = (wall + patches).clip(0, 255)
    assert with_floor(background, still).floor == MIN_FLOOR
    assert MIN_FLOOR < with_floor(background, flickering).floor <= MAX_FLOOR


def test_difference_is_infinite_where_the_background_is_unknown() -> None:
    wall = scenes.backdrop(0)
    background = fit_background(np.stack([noisy(wall, t) for t in range(6)]))
    doubtful = np.zeros(wall.shape[:2], bool)
    doubtful[:10] = True
    found = difference(wall, background.without(doubtful))
    assert np.isinf(found[:10]).all()
    assert found[12:].max() < 10
