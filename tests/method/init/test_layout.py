"""Measures of a scene."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from splatreel.method.init.layout import MAX_CLEAR_SHARE, Layout, border_color, clearance_of, limits, measure, upright
from splatreel.scene.camera import Camera
from tests.method.scenes import look_at, ring
from toyroom.capture import HELD_OUT, make_cameras

CAMERAS = ring(7, width=96, height=64)
BALL = np.random.default_rng(0).normal(size=(4000, 3)) * 0.2


def test_layout_dict_round_trip() -> None:
    layout = measure(CAMERAS, BALL, 0.1)
    assert Layout.from_dict(layout.to_dict()) == layout
    before = {name: value for name, value in layout.to_dict().items() if name != "clearance"}
    assert Layout.from_dict(before).clearance.share == 0, "of a run that began without one"


def test_clearance_focus_and_share() -> None:
    clearance = clearance_of(CAMERAS, BALL)
    np.testing.assert_allclose(clearance.focus, 0, atol=0.3)
    assert clearance.share == MAX_CLEAR_SHARE


@pytest.mark.parametrize("depth", [1.2, 0.4])
def test_clearance_never_hides_content_near_a_camera(depth: float) -> None:
    """A post takes a hundredth of the points of one of seven cameras, or a little more."""
    camera = CAMERAS[3]
    post = camera.center + depth * camera.viewmat[2, :3] + np.random.default_rng(1).normal(size=(60, 3)) * 0.02
    clearance = clearance_of(CAMERAS, np.concatenate([BALL, post]))
    assert 0.5 * depth < clearance.depth(camera) < depth
    assert not clearance.hides(post, camera).any()


def test_border_color_is_mean_near_borders() -> None:
    images = np.full((2, 80, 160, 3), 200, np.uint8)
    images[0, 10:70, 20:140] = 0
    images[1, 10:70, 20:140] = 255
    images[1, :10] = (100, 0, 200)
    images[1, 70:] = (100, 0, 200)
    red, green, blue = border_color(images)
    assert blue == pytest.approx(200 / 255, abs=1e-4)
    assert 100 / 255 < red < 200 / 255
    assert 0 < green < red


def test_clearance_without_points_is_zero() -> None:
    away = [look_at([0, 0, -4 - i], target=(0, 0, -9)) for i in range(3)]
    assert clearance_of(away, BALL).share == 0


WORLD = Rotation.from_euler("xyz", [50, -20, 130], degrees=True).as_matrix()
"""From upright coordinates, y up, to the world's."""
UP = WORLD[:, 1]


def off(cameras: list[Camera]) -> float:
    """Return the error in degrees."""
    return float(np.degrees(np.arccos(np.clip(upright(cameras) @ UP, -1, 1))))


def mean_off(cameras: list[Camera]) -> float:
    mean = -np.mean([camera.viewmat[1, :3] for camera in cameras], axis=0)
    return float(np.degrees(np.arccos(mean @ UP / np.linalg.norm(mean))))


def camera(azimuth: float, height: float, roll: float = 0, *, radius: float = 4, at=(0, 0, 0), size=(64, 48)) -> Camera:
    """Return a camera that looks at a point from `radius` away and `height` above it; angles in degrees."""
    a = np.radians(azimuth)
    center = np.array([radius * np.sin(a), height, radius * np.cos(a)]) + at
    z = (at - center) / np.linalg.norm(at - center)
    x = np.cross(z, [0, 1, 0])
    x /= np.linalg.norm(x)
    axes = Rotation.from_euler("z", roll, degrees=True).as_matrix() @ np.stack([x, np.cross(z, x), z])
    viewmat = np.eye(4)
    viewmat[:3, :3] = axes @ WORLD.T
    viewmat[:3, 3] = -viewmat[:3, :3] @ WORLD @ center
    K = np.array([[64, 0, size[0] / 2], [0, 64, size[1] / 2], [0, 0, 1]])
    return Camera(f"{azimuth:g} {height:g} {roll:g}", viewmat, K, *size)


def rolls(count: int, degrees: float) -> np.ndarray:
    return np.random.default_rng(1).normal(0, degrees, count)


ARC = [
    camera(a, h, r)
    for (a, h), r in zip([(a, h) for a in np.linspace(-35, 35, 10) for h in (1, 2)], rolls(20, 1), strict=True)
]
RIGS = {
    "an arc that looks down, as Neu3DV's": ARC,
    "a dome that looks inward and down, on one side more, as Panoptic's": [
        camera(a, h, r)
        for a, h, r in zip(np.r_[0:360:17, 60:180:20], np.linspace(0.5, 6, 28), rolls(28, 1), strict=True)
    ],
    "a grid that looks one way, as Technicolor's": [
        camera(3 * i, 1.5 + 0.3 * j, r, at=(0.3 * i, 0.3 * j, 0))
        for (i, j), r in zip([(i, j) for i in range(-2, 2) for j in range(-2, 2)], rolls(16, 0.2), strict=True)
    ],
    "half a ring, as ENeRF's": [camera(a, 1.5, r) for a, r in zip(np.linspace(-90, 90, 18), rolls(18, 1), strict=True)],
    "anywhere, by hand, as of COLMAP": [
        camera(a, h, r)
        for a, h, r in zip(
            np.random.default_rng(2).uniform(-70, 70, 30), np.linspace(-0.5, 5, 30), rolls(30, 4), strict=True
        )
    ],
}


@pytest.mark.parametrize("rig", RIGS)
def test_upright_of_level_cameras_looking_down(rig: str) -> None:
    assert off(RIGS[rig]) < min(4, mean_off(RIGS[rig]) / 5)


def test_upright_of_builtin_capture() -> None:
    cameras = [camera for camera in make_cameras() if camera.name not in HELD_OUT]
    layout = measure(cameras, np.random.default_rng(0).normal(size=(500, 3)), 0.1)
    assert np.degrees(np.arccos(layout.up[1])) < 0.5, "15.3 by the mean"


@pytest.mark.parametrize("side", [90, -90])
def test_upright_ignores_rolled_camera(side: float) -> None:
    assert off([*ARC, camera(12, 1.5, side)]) < 1.5
    assert off([*ARC[::3], camera(-40, 1.5, side), camera(-30, 1, side)]) < 4, "two of nine"


def test_upright_with_portrait_and_landscape_phones() -> None:
    """Portrait images are taller than wide, but as level as the others."""
    phones = [camera(a, 1.6, size=(36, 64) if i % 2 else (64, 36)) for i, a in enumerate((-50, -20, 15, 40))]
    assert off(phones) < 0.5


def test_upright_uses_mean_if_right_axes_are_ambiguous() -> None:
    one = camera(20, 1.5)
    assert off([one]) == pytest.approx(mean_off([one]), abs=1e-3), "one camera"
    column = [camera(0, h, at=(x, h, 0)) for h in (0.5, 1.0, 1.5) for x in (-1, 0, 1)]
    assert off(column) == pytest.approx(mean_off(column), abs=0.1), "parallel right axes"
    rolled = [camera(a, 0.5, r) for a, r in zip(range(0, 360, 9), rolls(40, 60), strict=True)]
    assert off(rolled) == pytest.approx(mean_off(rolled), abs=1e-3), "rolled at random"


def test_upright_of_opposite_cameras_has_default() -> None:
    hung = [camera(0, 0, roll) for roll in (0, 180)]
    assert np.linalg.norm(upright(hung)) == pytest.approx(1)


BALL_POINTS = np.random.default_rng(0).normal(size=(3000, 3)) * 0.3


def arc(step: float, count: int = 9, height: float = 1.0, radius: float = 4.0) -> list[Camera]:
    """Return cameras `step` degrees apart around the vertical axis, which look at the origin from above; y is down."""
    angles = np.radians(step * (np.arange(count) - count // 2))
    flat = np.sqrt(radius**2 - height**2)
    return [look_at([flat * np.sin(a), -height, -flat * np.cos(a)]) for a in angles]


def laid_out(cameras: list[Camera]) -> Layout:
    layout = measure(cameras, BALL_POINTS, 0.1)
    return replace(layout, clearance=replace(layout.clearance, focus=(0.0, 0.0, 0.0)), up=[0.0, -1.0, 0.0])


def test_limits_angle_follows_camera_spacing() -> None:
    found = limits(arc(16, height=0.1), BALL_POINTS, laid_out(arc(16, height=0.1)))
    assert found is not None
    assert found.angle == pytest.approx(0.75 * 16 + 5, abs=0.1)
    assert found.focus == (0, 0, 0)
    assert found.distance == pytest.approx((1, 5), abs=0.01)


@pytest.mark.parametrize(("step", "angle"), [(1, 10), (40, 35), (59, 45)])
def test_limits_angle_is_clamped(step: float, angle: float) -> None:
    cameras = arc(step, count=6, height=0.01)
    found = limits(cameras, BALL_POINTS, laid_out(cameras))
    assert found is not None
    assert found.angle == pytest.approx(angle, abs=0.2)


def test_limits_angle_ignores_one_distant_camera() -> None:
    cameras = [*arc(8, count=12, height=0.01), look_at([0, -0.01, 4])]
    found = limits(cameras, BALL_POINTS, laid_out(cameras))
    assert found is not None
    assert found.angle == pytest.approx(0.75 * 8 + 5, abs=0.2)


def test_limits_floor_is_below_scene_and_cameras() -> None:
    cameras = arc(10)
    floor = np.c_[np.random.default_rng(1).uniform(-3, 3, (3000, 2)), np.full(3000, 0.8)][:, [0, 2, 1]]
    stray = np.array([[0, 5, 0], [1, 3, 1], [0, 900, 0]])
    found = limits(cameras, np.concatenate([BALL_POINTS, floor, stray]), laid_out(cameras))
    assert found is not None
    assert found.floor == pytest.approx(-0.8, abs=0.05), "y is down, and a few points below the floor are noise"
    low = [look_at([x, 2.5, -3]) for x in (-1, 0, 1)]
    found = limits([*cameras, *low], BALL_POINTS, laid_out([*cameras, *low]))
    assert found is not None
    assert found.floor == pytest.approx(-2.5), "a camera on the ground shows that one can be there"
    few = limits(cameras, BALL_POINTS[:20], laid_out(cameras))
    assert few is not None
    assert few.floor is None


def test_limits_of_outward_cameras_are_none() -> None:
    outward = [look_at(c.center * 0.1, target=tuple(c.center)) for c in arc(40)]
    assert limits(outward, BALL_POINTS, laid_out(outward)) is None


def test_limits_angle_is_lowered_by_failed_trial() -> None:
    cameras = arc(16, height=0.1)
    lowered, left = (limits(cameras, BALL_POINTS, laid_out(cameras), most) for most in (7.5, 40.0))
    assert lowered is not None
    assert left is not None
    assert lowered.angle == 7.5
    assert left == limits(cameras, BALL_POINTS, laid_out(cameras))
