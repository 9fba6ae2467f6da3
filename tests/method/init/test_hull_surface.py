"""Tests of `method/init/hull_surface.py`."""

import numpy as np

from splatreel.method.init.hull_surface import close_surface
from splatreel.method.init.initial_points import InitialPoints
from splatreel.scene.volumes import Sphere
from tests.method.scenes import look_at

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
