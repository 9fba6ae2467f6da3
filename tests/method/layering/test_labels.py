"""Separation of static from dynamic points."""

import numpy as np
import pytest

from splatreel.config import LayeringConfig
from splatreel.kernels.image import render_image
from splatreel.method.layering import labels as module
from splatreel.method.layering.labels import (
    MIN_AGREEING_SHARE,
    MIN_CHANGE,
    RelitPoints,
    changes_of_light,
    convertible,
    find_layers,
    near_cameras,
    separate,
)
from splatreel.method.layering.lift import shares
from splatreel.scene.clearance import Clearance
from splatreel.scene.gaussians import C0, Gaussians, StaticPoints
from tests.any_threads import assert_same_on_any_threads
from tests.method.captures import blots
from tests.method.inputs import group_input
from tests.method.scenes import look_at, random_gaussians, ring


def test_separate_sorts_points_by_labels():
    static, dynamic = random_gaussians(6, seed=0), random_gaussians(4, seed=1)
    alive = np.array([True, False, True, True, True, False])
    moves = np.array([True, False, True, True, False, True, False, False])
    light = np.zeros((3, 8), np.float32)
    light[1, [1, 3, 4]] = -0.5
    layers = separate(StaticPoints(static, alive), dynamic, moves, light)
    assert layers.alive.tolist() == [False, False, False, True, True, False]
    assert len(layers.new_static) == 0
    np.testing.assert_array_equal(layers.dynamic.means, np.concatenate([dynamic.means[[0, 2, 3]], static.means[[2]]]))
    np.testing.assert_array_equal(layers.relit.points.means, np.stack([dynamic.means[1], static.means[0]]))
    np.testing.assert_array_equal(layers.relit.light, np.array([[0, 0], [-0.5, -0.5], [0, 0]], np.float32))
    separated = separate(StaticPoints(static, alive), dynamic, moves, 0 * light)
    np.testing.assert_array_equal(separated.new_static.means, dynamic.means[[1]])
    assert separated.alive.tolist() == [True, False, False, True, True, False]


def test_nothing_moves_and_everything_moves():
    static, dynamic = StaticPoints(random_gaussians(3), np.ones(3, bool)), random_gaussians(2, seed=1)
    still = separate(static, dynamic, np.zeros(5, bool), np.zeros((4, 5)))
    assert (len(still.dynamic), len(still.new_static), still.alive.sum()) == (0, 2, 3)
    moving = separate(static, dynamic, np.ones(5, bool), np.zeros((4, 5)))
    assert (len(moving.dynamic), len(moving.new_static), moving.alive.sum()) == (5, 0, 0)


def test_without_layering_everything_moves():
    static, dynamic = StaticPoints(random_gaussians(3), np.ones(3, bool)), random_gaussians(2, seed=1)
    cameras = ring(3, width=64, height=48)
    data = group_input(np.zeros((2, 3, 48, 64, 3), np.uint8), cameras, near=0.1)
    for config, moving in ((LayeringConfig(enabled=False), 5), (LayeringConfig(), 0)):
        layers = find_layers(data, dynamic, static, config)
        assert (len(layers.dynamic), len(layers.new_static) + int(layers.alive.sum())) == (moving, 5 - moving)


def test_near_cameras_finds_points_that_clearance_would_hide():
    camera, other = look_at([0, 0, -4], width=64, height=48), look_at([0, 0, 4], width=64, height=48)
    points = np.array([[0, 0, -3.5], [2, 0, -3.5], [0, 0, 3.5], [0, 0, 0], [0, 0, -5]])
    clearance = Clearance((0.0, 0.0, 0.0), 0.25)
    assert near_cameras(points, [camera], clearance).tolist() == [True, False, False, False, False]
    assert near_cameras(points, [camera, other], clearance).tolist() == [True, False, True, False, False]


def test_convertible_points_lie_in_changing_pixels():
    """In a row of six points the last two darken. One more point is behind all cameras, and one is not alive."""
    means = np.concatenate([[[x, 0, 0] for x in np.linspace(-1.5, 1.5, 6)], [[0, 0, -50], [0, 0.5, 0]]])
    points = Gaussians(
        means, np.tile([1.0, 0, 0, 0], (8, 1)), np.full((8, 3), 0.1), np.full(8, 0.9), np.full((8, 1, 3), 1.5)
    )
    alive = np.arange(8) < 7
    dark = np.where(np.isin(np.arange(8), [4, 5]), -0.8, 0.0)
    cameras = ring(3, width=64, height=48)
    static = StaticPoints(points, alive)
    darker = points.shaded(np.stack([dark, dark, dark, 0 * dark], 1).astype(np.float32))[alive]
    films = [[render_image(scene, camera, near=0.1) for camera in cameras] for scene in (static.living, darker)]
    data = group_input((np.clip(films, 0, 1) * 255).astype(np.uint8), cameras, near=0.1)
    assert convertible(data, static, 0.3).tolist() == [False, False, False, False, True, True, True, False]
    assert convertible(data, static, 0.0).tolist() == alive.tolist()


def test_relit_colors_follow_light() -> None:
    points = random_gaussians(5, sh_degree=1)
    light = np.log(np.linspace(0.5, 1.5, 15)).reshape(3, 5).astype(np.float32)
    lit = RelitPoints(points, light)
    assert len(lit) == 5
    for frame in range(3):
        there = lit.at(frame)
        color, base = 0.5 + C0 * there.sh[:, 0], 0.5 + C0 * points.sh[:, 0]
        np.testing.assert_allclose(color, base * np.exp(light[frame])[:, None], atol=1e-5)
        np.testing.assert_array_equal(there.sh[:, 1:], points.sh[:, 1:])
        np.testing.assert_array_equal(there.opacities, points.opacities)
        np.testing.assert_array_equal(lit.tracks[frame], points.means)


def test_relit_black_stays_black() -> None:
    points = random_gaussians(2)
    points.sh[:, 0] = -3
    assert not RelitPoints(points, np.ones((4, 2), np.float32)).shades.any()


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


def test_light_is_the_same_on_any_threads() -> None:
    lit = film(shadow(3, 5))
    assert_same_on_any_threads(lambda: changes_of_light(WALL, CAMERAS, lit, NEAR))
    assert_same_on_any_threads(lambda: shares(WALL, CAMERAS, lit[3, ..., 0] < 100, NEAR))


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
