"""Backgrounds of static cameras."""

import numpy as np
import pytest

from splatreel.segmentation.background import fit_background, same_light
from tests.segmentation import scenes


def noisy(image: np.ndarray, seed: int, sigma: float = 1.5) -> np.ndarray:
    return (image + np.random.default_rng(seed).normal(0, sigma, image.shape)).clip(0, 255).astype(np.uint8)


def test_background_is_found_below_a_person_who_covers_it_most_of_the_time() -> None:
    behind = scenes.backdrop(0)
    film = np.stack([noisy(behind, t) for t in range(20)])
    for t in range(12):  # cloth changes its color by more than the noise
        film[t, 20:40, 30:50] = np.random.default_rng(t).uniform(20, 90)
    found = fit_background(film)
    assert found.known.all()
    assert np.abs(found.image - behind).max() < 6
    assert np.abs(found.share[20:40, 30:50] - 0.4).max() < 0.1


def test_pixel_that_never_repeats_a_color_is_unknown() -> None:
    film = np.stack([noisy(scenes.backdrop(0), t) for t in range(8)])
    for t in range(8):
        film[t, 10:20, 10:20] = 30 * t
    found = fit_background(film)
    assert not found.known[12:18, 12:18].any()
    assert found.known[30:].all()


def test_background_follows_exposure_and_a_slow_change_of_light() -> None:
    behind = scenes.backdrop(1).astype(np.float32)
    found = fit_background(np.stack([noisy(behind, t) for t in range(6)]))
    ramp = np.linspace(0.85, 1.1, behind.shape[1])[None, :, None]
    lit = found.lit((behind * ramp).clip(0, 255).astype(np.uint8))
    assert np.median(np.abs(lit - behind * ramp)) < 0.5 * np.median(np.abs(behind - behind * ramp))


@pytest.mark.parametrize("factor", [0.5, 0.7, 1.3])
@pytest.mark.parametrize("part", [1.0, 0.5], ids=["room", "half"])
def test_background_follows_lamps_that_are_switched(factor: float, part: float) -> None:
    behind = scenes.backdrop(1).astype(np.float32)
    lamp = np.where(np.arange(scenes.WIDTH) < part * scenes.WIDTH, factor, 1)[:, None]
    film = np.stack([noisy((behind * (lamp if t < 4 else 1)).clip(0, 255), t) for t in range(10)])
    film[:, 20:40, 30:45] = np.random.default_rng(0).uniform(20, 200, (10, 20, 15, 3))
    found = fit_background(*same_light(film))
    for frame in (film[0], film[9]):
        error = np.abs(found.lit(frame) - frame).max(-1)
        error[15:45, 25:50] = 0
        error[:, abs(np.arange(scenes.WIDTH) - part * scenes.WIDTH) < 9] = 0  # the border of the lamp's light
        assert (error > 15).mean() < 0.03


def test_samples_of_one_light_stay_as_they_are() -> None:
    film = np.stack([noisy(scenes.backdrop(2), t) for t in range(6)])
    film[:, 10:50, 20:40] = np.random.default_rng(0).uniform(20, 200, (6, 40, 20, 3))
    same, certainty = same_light(film)
    assert same is film
    assert certainty is None
