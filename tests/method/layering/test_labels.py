"""Separation of static from dynamic points."""

import numpy as np

from splatreel.config import LayeringConfig
from splatreel.kernels.image import render_image
from splatreel.method.layering.labels import RelitPoints, convertible, find_layers, near_cameras, separate
from splatreel.scene.clearance import Clearance
from splatreel.scene.gaussians import C0, Gaussians, StaticPoints
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
