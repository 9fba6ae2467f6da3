"""Changes of light: a part of a wall is in shadow for some frames, while a cluster passes in front of it."""

import numpy as np
import pytest

from splatreel.kernels.image import render_image
from splatreel.method.layering import light_changes as module
from splatreel.method.layering.labels import RelitPoints
from splatreel.method.layering.light_changes import MIN_AGREEING_SHARE, MIN_CHANGE, changes_of_light
from splatreel.scene.gaussians import Gaussians
from tests.method.captures import blots
from tests.method.scenes import ring

NEAR, FRAMES, DARK = 0.8, 8, -0.5
CAMERAS = ring(5, width=96, height=64)
WALL = blots(900, [-5, -3.5, 0.9], [5, 3.5, 1.0], 0.2, 0)
THING = blots(40, [-1.0, -1.6, -1.2], [-0.4, -1.0, -0.8], 0.1, 1)
INSIDE = (WALL.means[:, :2] > [0.2, -0.8]).all(1) & (WALL.means[:, :2] < [1.6, 0.8]).all(1)
WELL_INSIDE = (WALL.means[:, :2] > [0.5, -0.5]).all(1) & (WALL.means[:, :2] < [1.3, 0.5]).all(1)


def film(light: np.ndarray, *passing: Gaussians, noise: float = 1.0) -> np.ndarray:
    """Return images [T, C, H, W, 3] of the wall with light [T, N], and of a cluster that moves by 0.2 per frame."""
    rng, lit, frames = np.random.default_rng(0), RelitPoints(WALL, light), []
    for t in range(FRAMES):
        identity = [np.tile([1.0, 0, 0, 0], (len(thing), 1)) for thing in passing]
        there = [thing.moved(np.array([0.2 * t, 0, 0]), q) for thing, q in zip(passing, identity, strict=True)]
        scene = Gaussians.concatenate([lit.at(t), *there])
        frames.append([render_image(scene, camera, near=NEAR) for camera in CAMERAS])
    film = 255 * np.array(frames) + noise * rng.normal(size=(FRAMES, len(CAMERAS), 64, 96, 3))
    return film.clip(0, 255).round().astype(np.uint8)


def shadow(first: int, last: int) -> np.ndarray:
    """Return light [T, N] with a shadow on a part of the wall between two frames."""
    light = np.zeros((FRAMES, len(WALL)), np.float32)
    light[first : last + 1, INSIDE] = DARK
    return light


def test_light_finds_shadow_in_space_and_time() -> None:
    light = changes_of_light(WALL, CAMERAS, film(shadow(3, 5)), NEAR)
    assert light.shape == (FRAMES, len(WALL))
    dark = light[3:6, WELL_INSIDE]
    assert (dark < -MIN_CHANGE).mean() > 0.6, "of those that others do not hide"
    assert np.median(dark[dark < -MIN_CHANGE]) == pytest.approx(DARK, abs=0.15), (
        "noise of black is no light, so a little less"
    )
    assert np.abs(light[:3]).max() < MIN_CHANGE
    assert np.abs(light[6:]).max() < MIN_CHANGE
    far = (np.abs(WALL.means[:, :2] - [0.9, 0]) > [1.3, 1.4]).any(1)
    assert not light[:, far].any()


def test_light_finds_brightening() -> None:
    light = changes_of_light(WALL, CAMERAS, film(-0.6 * shadow(3, 5)), NEAR)
    assert (light[3:6, WELL_INSIDE] > MIN_CHANGE).mean() > 0.5


def test_light_ignores_passing_object() -> None:
    light = changes_of_light(WALL, CAMERAS, film(0 * shadow(3, 5), THING), NEAR)
    assert (light != 0).any(0).mean() < 0.02
    with_shadow = changes_of_light(WALL, CAMERAS, film(shadow(3, 5), THING), NEAR)
    assert (with_shadow[3:6, WELL_INSIDE] < -MIN_CHANGE).mean() > 0.6


def test_light_ignores_single_frame_and_noise() -> None:
    assert not changes_of_light(WALL, CAMERAS, film(shadow(4, 4)), NEAR).any()
    assert (changes_of_light(WALL, CAMERAS, film(0 * shadow(1, 1), noise=8), NEAR) != 0).any(0).mean() < 0.02


def test_light_ignores_change_of_one_camera() -> None:
    frames = film(0 * shadow(3, 5))
    frames[3:6, 1] //= 2
    assert 1 / len(CAMERAS) < MIN_AGREEING_SHARE
    assert not changes_of_light(WALL, CAMERAS, frames, NEAR).any()


def test_light_ignores_change_of_whole_scene() -> None:
    light = np.full((FRAMES, len(WALL)), DARK, np.float32)
    light[:2] = 0
    assert not changes_of_light(WALL, CAMERAS, film(light), NEAR).any()
    found = changes_of_light(WALL, CAMERAS, film(light + shadow(3, 5)), NEAR)
    assert (found[3:6, WELL_INSIDE] < -MIN_CHANGE).mean() > 0.5
    assert (found[:, ~INSIDE] != 0).any(0).mean() < 0.05


def test_light_keeps_strongest_changes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_CHANGED_SHARE", 0.01)
    found = (changes_of_light(WALL, CAMERAS, film(shadow(3, 5)), NEAR) != 0).any(0)
    assert found.sum() == 9
    assert found[INSIDE].sum() == 9


@pytest.mark.parametrize("frames", [1, 2])
def test_light_of_too_few_frames_is_zero(frames: int) -> None:
    assert not changes_of_light(WALL, CAMERAS, film(shadow(1, 5))[:frames], NEAR).any()


def test_light_without_points() -> None:
    assert changes_of_light(Gaussians.empty(0), CAMERAS, film(shadow(3, 5)), NEAR).shape == (FRAMES, 0)


def test_common_changes_are_medians_of_the_views_that_see_a_point() -> None:
    rng = np.random.default_rng(0)
    shown = (rng.normal(0, 0.1, (7, 40, 5)) + rng.normal(0, 0.2, (40, 5))).astype(np.float32)
    for point in range(40):
        shown[rng.permutation(7)[: point % 5], point] = np.nan
    found = module._common_changes(shown)
    assert found.shape == (5, 40)
    for point in range(40):
        seen = shown[~np.isnan(shown[:, point, 0]), point]
        middle = np.median(seen, 0)
        limit = np.maximum(module.ABSOLUTE_TOLERANCE, module.RELATIVE_TOLERANCE * np.abs(middle))
        agreed = (np.abs(seen - middle) < limit).mean(0) >= MIN_AGREEING_SHARE
        np.testing.assert_array_equal(found[:, point], np.where(agreed, middle, 0))
    assert 0.1 < (found != 0).mean() < 0.9
