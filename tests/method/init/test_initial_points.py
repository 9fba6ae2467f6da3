"""Initial points of a scene."""

from dataclasses import replace

import numpy as np
import pytest

from splatreel.base.errors import ReconstructionError
from splatreel.method.init import planesweep
from splatreel.method.init.initial_points import (
    MAX_POINTS,
    InitialPoints,
    _filled,
    close_surface,
    depth_ranges,
    initial_points,
    near_plane,
)
from splatreel.method.init.layout import viewing_distance
from splatreel.method.init.planesweep import DepthMap
from splatreel.method.init.triangulate import nearest_cameras, triangulate
from splatreel.scene.volumes import Sphere
from tests.any_threads import assert_same_on_any_threads
from tests.method.corner import FLOOR, HEIGHT, WALL, WIDTH, arc, depth_of, make_image, make_images
from tests.method.scenes import look_at


def surface_error(points: np.ndarray) -> np.ndarray:
    """Return the distance [P] to the floor or the wall, whichever is nearer."""
    return np.minimum(np.abs(points[:, 1] - FLOOR), np.abs(points[:, 2] - WALL))


def test_triangulated_points_lie_on_surfaces() -> None:
    cameras = arc()
    tracks = triangulate(cameras, make_images(cameras))
    assert len(tracks.points) > 100
    assert (tracks.seen.sum(1) >= 3).all()
    assert np.percentile(surface_error(tracks.points), 95) < 0.1
    assert tracks.colors.min() >= 0
    assert tracks.colors.max() <= 1


def test_triangulate_without_texture_gives_no_points() -> None:
    cameras = arc()
    assert len(triangulate(cameras, np.full((5, HEIGHT, WIDTH, 3), 90, np.uint8)).points) == 0


def test_sweep_depth_is_right_where_neighbors_agree() -> None:
    cameras = arc()
    maps = planesweep.sweep(cameras, make_images(cameras), np.tile([1.5, 10.0], (5, 1)), width=WIDTH, planes=64)
    for camera, found in zip(cameras, maps, strict=True):
        trusted = found.agreeing >= 2
        assert trusted.mean() > 0.5
        error = np.abs(found.depth / depth_of(camera) - 1)
        assert np.median(error[trusted]) < 0.02
        assert (error[trusted] < 0.06).mean() > 0.95


def test_initial_points_cover_scene_with_colors() -> None:
    cameras = arc(6)
    held_out, training = cameras[2], cameras[:2] + cameras[3:]
    result = initial_points(training, make_images(training))
    assert result.source == "triangulated+swept"
    assert result.points.dtype == result.colors.dtype == np.float32
    assert 1000 < len(result.points) <= MAX_POINTS + 5 * 500
    assert np.median(surface_error(result.points)) < 0.05
    pixels, _ = planesweep.project(held_out, result.points.astype(np.float64))
    seen = planesweep.inside(held_out, pixels)
    column, row = pixels[seen].astype(int).T
    expected = make_image(held_out)[row, column] / 255
    assert np.abs(expected - result.colors[seen]).mean() < 0.1
    cells = np.zeros((HEIGHT // 16, WIDTH // 16), bool)
    cells[row // 16, column // 16] = True
    assert cells.all(), "a part of a new view starts empty"


def test_initial_points_are_the_same_on_any_threads() -> None:
    cameras = arc()
    images = make_images(cameras)
    assert_same_on_any_threads(lambda: initial_points(cameras, images))


def test_plain_area_takes_depth_of_surroundings() -> None:
    cameras = arc()
    points = initial_points(cameras, make_images(cameras, bare=0.5)).points
    strip = (np.abs(points[:, 0]) < 0.3) & (points[:, 1] > 0.6) & (points[:, 2] < 5)
    assert strip.sum() > 50
    assert np.median(np.abs(points[strip, 1] - FLOOR)) < 0.1


def test_filled_points_do_not_float_between_surfaces() -> None:
    """A flat patch between a near and a far wall gets the depth of one of them."""
    camera = arc()[0]
    depth = np.where(np.arange(WIDTH) < WIDTH // 2, 2.0, 6.0) * np.ones((HEIGHT, 1))
    unsure = np.abs(np.arange(WIDTH) - WIDTH // 2) < 24
    agreeing = np.where(unsure, 0, 4) * np.ones((HEIGHT, 1), int)
    flat = DepthMap(
        camera, np.full((HEIGHT, WIDTH, 3), 128, np.uint8), depth.astype(np.float32), agreeing.astype(np.uint8)
    )
    found = planesweep.project(camera, _filled(flat, 2, np.zeros((0, 3))).points)[1]
    assert len(found) > 20
    assert {2.0, 6.0} == set(found.round(3).tolist())


def test_initial_points_keep_capture_points() -> None:
    cameras = arc()
    rng = np.random.default_rng(0)
    own = np.c_[rng.uniform(-1, 1, (200, 2)), np.full(200, WALL)]
    result = initial_points(cameras, make_images(cameras), own, np.full((200, 3), 0.5))
    assert result.source == "capture+swept"
    assert np.median(surface_error(result.points)) < 0.1


def test_scene_without_texture_starts_from_random_points() -> None:
    cameras = arc()
    images = np.full((5, HEIGHT, WIDTH, 3), 90, np.uint8)
    result = initial_points(cameras, images, near=0.3)
    assert result.source == "random"
    assert np.isfinite(result.points).all()
    np.testing.assert_allclose(result.colors, 90 / 255, atol=1e-6)
    assert all(planesweep.inside(c, planesweep.project(c, result.points)[0]).mean() > 0.3 for c in cameras)
    np.testing.assert_array_equal(result.points, initial_points(cameras, images, near=0.3).points)


@pytest.mark.parametrize("count", [1, 2])
def test_initial_points_of_few_cameras(count: int) -> None:
    cameras = arc()[:count]
    result = initial_points(cameras, make_images(cameras))
    assert len(result.points) > 500
    assert np.isfinite(result.points).all()


def test_initial_points_refuse_wrong_input() -> None:
    cameras = arc()
    images = make_images(cameras)
    with pytest.raises(ReconstructionError, match=r"expected uint8 \[5, H, W, 3\]"):
        initial_points(cameras, images[:4])
    with pytest.raises(ReconstructionError, match="'cam1' is 99x128"):
        initial_points([cameras[0], replace(cameras[1], width=99), *cameras[2:]], images)
    with pytest.raises(ReconstructionError, match="NaN"):
        initial_points(cameras, images, np.array([[np.nan, 0, 0]]))


def test_measures_of_known_scene() -> None:
    cameras = arc()
    rng = np.random.default_rng(0)
    points = np.c_[rng.uniform(-1, 1, (4000, 2)), rng.uniform(4, 6, 4000)]
    assert viewing_distance(cameras, points) == pytest.approx(5, abs=0.1)
    assert near_plane(cameras, points) == pytest.approx(0.5, abs=0.03)
    ranges = depth_ranges(cameras, points)
    assert (ranges[:, 0] < 4).all()
    assert (ranges[:, 1] > 18).all(), "what is seen through a window is out of range"
    assert (depth_ranges(cameras, points, near=3.5)[:, 0] >= 3.5).all()


def test_measures_without_points_use_cameras() -> None:
    cameras, none = arc(), np.zeros((0, 3))
    ranges = depth_ranges(cameras, none)
    assert np.isfinite(ranges).all()
    assert (ranges[:, 0] > 0).all()
    assert (ranges[:, 0] < ranges[:, 1]).all()
    assert 0 < near_plane(cameras, none) < ranges.max()


def test_nearest_cameras_are_neighbors_in_arc() -> None:
    nearest = nearest_cameras(arc(5), 2)
    assert set(nearest[2]) == {1, 3}
    assert nearest[0, 0] == 1
    assert nearest_cameras(arc(2), 4).shape == (2, 1)


BALL = Sphere(np.zeros(3), 0.5)
CAMERAS = [look_at([4 * np.sin(a), 0, -4 * np.cos(a)], width=240, height=160, name=str(a)) for a in (-0.6, 0.6)]
"""Two cameras, 69 degrees apart, before the ball. None is behind it."""


def test_surface_encloses_the_subject_all_around() -> None:
    images = np.full((2, 160, 240, 3), 200, np.uint8)
    dense = InitialPoints(sphere_points(400), np.full((400, 3), 0.5), "swept")
    found = close_surface(dense, CAMERAS, images, BALL, 4.0)
    added = found.points[len(found.points) - surface_count(found) :]
    radii = np.linalg.norm(added, axis=1)
    assert radii.max() <= 0.5
    assert radii.min() > 0.4
    directions = added / radii[:, None]
    for direction in np.concatenate([np.eye(3), -np.eye(3)]):
        assert (directions @ direction).max() > 0.95
    assert found.source == "swept+hull"


def test_unseen_side_takes_colors_of_the_seen_one() -> None:
    images = np.full((2, 160, 240, 3), 51, np.uint8)
    dense = InitialPoints(sphere_points(400), np.full((400, 3), 0.9), "swept")
    found = close_surface(dense, CAMERAS, images, BALL, 4.0)
    added = slice(len(found.points) - surface_count(found), None)
    behind = found.points[added, 2] > 0.4
    assert behind.any()
    np.testing.assert_allclose(found.colors[added][behind], 0.2, atol=0.01)


def test_places_of_different_colors_are_carved() -> None:
    images = np.full((2, 160, 240, 3), 0, np.uint8)
    dense = InitialPoints(sphere_points(400), np.full((400, 3), 0.5), "swept")
    alike = surface_count(close_surface(dense, CAMERAS, images, BALL, 4.0))
    images[1] = 255
    found = close_surface(dense, CAMERAS, images, BALL, 4.0)
    both_see = found.points[np.abs(found.points[:, 0]) < 0.1]
    assert both_see[:, 2].min() > -0.45, "the front, which both cameras see"
    assert surface_count(found) < alike


def surface_count(found: InitialPoints) -> int:
    """Return the number of added points: the first points are gray, 0.5 or 0.9."""
    return int((~np.isclose(found.colors[:, 0], 0.5) & ~np.isclose(found.colors[:, 0], 0.9)).sum())


def sphere_points(count: int) -> np.ndarray:
    """Return points spread over the ball."""
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(count, 3))
    return 0.49 * directions / np.linalg.norm(directions, axis=1, keepdims=True)
