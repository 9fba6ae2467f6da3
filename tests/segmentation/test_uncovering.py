"""Backgrounds of pixels that the subject covers most of the time."""

import numpy as np

from splatreel.segmentation.background import fit_background
from splatreel.segmentation.colors import ColorModel
from splatreel.segmentation.uncovering import uncover
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
