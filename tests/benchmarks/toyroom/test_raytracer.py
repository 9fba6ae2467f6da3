import math

import numpy as np
import pytest

from splatreel.scene.camera import Camera
from toyroom import raytracer as rt
from toyroom import room as toys
from toyroom import solids as sd
from toyroom.capture import make_cameras
from toyroom.textures import MIRROR

NOTHING = sd.Shapes(np.zeros((0, sd.SOLID_COLUMNS)), np.zeros((0, sd.BODY_COLUMNS)))


def solid(
    kind: int, position: tuple[float, float, float], half: tuple[float, float, float], texture: int = 0
) -> sd.Shapes:
    row = np.zeros(sd.SOLID_COLUMNS)
    row[[sd.KIND, sd.TEXTURE, sd.SCALE, sd.REACH]] = kind, texture, 1, np.linalg.norm(half)
    row[sd.POSITION : sd.POSITION + 3], row[sd.HALF : sd.HALF + 3] = position, half
    row[sd.ROTATION : sd.ROTATION + 9], row[sd.COLORS :] = np.eye(3).ravel(), 0.5
    return sd.Shapes(row[None], np.array([[*position, np.linalg.norm(half), 0, 1, 1]]))


def front(size: int = 65) -> Camera:
    """Return a camera at z = 4 looking along -z with y up."""
    viewmat = np.diag([1.0, -1.0, -1.0, 1.0])
    viewmat[2, 3] = 4
    return Camera("front", viewmat, np.array([[size, 0, size / 2], [0, size, size / 2], [0, 0, 1]]), size, size)


def together(a: sd.Shapes, b: sd.Shapes) -> sd.Shapes:
    moved = b.bodies.copy()
    moved[:, [sd.FIRST, sd.END]] += len(a.solids)
    return sd.Shapes(np.concatenate([a.solids, b.solids]), np.concatenate([a.bodies, moved]))


@pytest.mark.parametrize(
    ("kind", "depth", "area"),
    [
        (sd.BOX, 4 - 0.5, 1.0 * 0.8 / 3.5**2),  # its front face as seen from 3.5
        (sd.ELLIPSOID, 4 - 0.5, math.pi * 0.5 * 0.4 / (16 - 0.25)),
        (sd.CYLINDER, 4 - 0.5, None),
    ],
)
def test_solids_have_correct_distance_and_outline(kind: int, depth: float, area: float | None) -> None:
    camera = front()
    seen = rt.trace_static(camera, NOTHING, toys.LIGHT)
    cover, distance = rt.trace_cover(camera, seen, solid(kind, (0, 0, 0), (0.5, 0.4, 0.5)), np.ones(1, bool))
    assert distance[32, 32] == pytest.approx(depth, abs=2e-3)
    if area is not None:
        assert cover.sum() / 65**2 == pytest.approx(area, rel=0.03)


def test_moving_solids_look_like_static_ones() -> None:
    """A frame that reuses static results equals one traced anew, including mirror and shadows."""
    camera, light = make_cameras(96, 72)[3], toys.LIGHT
    still, moving = toys.standing(0), toys.moving(0.7)
    moving.solids[:, sd.OCCLUSION] = 0  # what moves does not darken the ambient light of what stands
    everything = together(still, moving)
    fast = rt.trace_frame(camera, rt.trace_static(camera, still, light), still, moving, light)
    slow = rt.trace_frame(camera, rt.trace_static(camera, everything, light), everything, NOTHING, light)
    np.testing.assert_array_equal(fast, slow)
    assert (slow != rt.trace_frame(camera, rt.trace_static(camera, still, light), still, NOTHING, light)).any(
        -1
    ).mean() > 0.1


def test_mirror_shows_objects_in_front_of_it() -> None:
    mirror = solid(sd.BOX, (0, 0, 0), (1, 1, 0.1), MIRROR)
    mirror.solids[:, sd.COLORS :] = 1.0
    red = solid(sd.ELLIPSOID, (0, 0, 6), (1, 1, 1))
    red.solids[:, sd.COLORS :] = [1, 0, 0] * 3
    image = rt.trace_frame(front(), rt.trace_static(front(), mirror, toys.LIGHT), mirror, red, toys.LIGHT)
    inside, outside = image[32, 32].astype(int), image[12, 32].astype(int)
    assert inside[0] > 100
    assert inside[1:].max() == 0
    assert outside.min() > 100  # the sky


def test_shadow_points_away_from_the_lamp() -> None:
    floor, ball = solid(sd.BOX, (0, -0.6, 0), (5, 0.1, 5)), solid(sd.ELLIPSOID, (0, 0, 0), (0.3, 0.3, 0.3))
    light = np.array([4.0, 4.0, 0.0])
    seen = rt.trace_static(front(), floor, light)
    before = rt.trace_frame(front(), seen, floor, NOTHING, light).astype(int)
    after = rt.trace_frame(front(), seen, floor, ball, light).astype(int)
    _, columns = np.nonzero((before - after).sum(-1)[39:] > 60)  # below the ball
    assert len(columns) > 10
    assert columns.max() < 33  # the lamp is at the right
