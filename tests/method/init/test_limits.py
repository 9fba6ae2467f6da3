"""Limits of viewpoints for known rigs."""

from dataclasses import replace

import numpy as np
import pytest

from splatreel.method.init.layout import Layout, measure
from splatreel.method.init.limits import limits
from splatreel.scene.camera import Camera
from tests.method.scenes import look_at

BALL = np.random.default_rng(0).normal(size=(3000, 3)) * 0.3


def arc(step: float, count: int = 9, height: float = 1.0, radius: float = 4.0) -> list[Camera]:
    """Return cameras `step` degrees apart around the vertical axis, which look at the origin from above; y is down."""
    angles = np.radians(step * (np.arange(count) - count // 2))
    flat = np.sqrt(radius**2 - height**2)
    return [look_at([flat * np.sin(a), -height, -flat * np.cos(a)]) for a in angles]


def laid_out(cameras: list[Camera]) -> Layout:
    layout = measure(cameras, BALL, 0.1)
    return replace(layout, clearance=replace(layout.clearance, focus=(0.0, 0.0, 0.0)), up=[0.0, -1.0, 0.0])


def test_limits_angle_follows_camera_spacing() -> None:
    found = limits(arc(16, height=0.1), BALL, laid_out(arc(16, height=0.1)))
    assert found is not None
    assert found.angle == pytest.approx(0.75 * 16 + 5, abs=0.1)
    assert found.focus == (0, 0, 0)
    assert found.distance == pytest.approx((1, 5), abs=0.01)


@pytest.mark.parametrize(("step", "angle"), [(1, 10), (40, 35), (59, 45)])
def test_limits_angle_is_clamped(step: float, angle: float) -> None:
    cameras = arc(step, count=6, height=0.01)
    found = limits(cameras, BALL, laid_out(cameras))
    assert found is not None
    assert found.angle == pytest.approx(angle, abs=0.2)


def test_limits_angle_ignores_one_distant_camera() -> None:
    cameras = [*arc(8, count=12, height=0.01), look_at([0, -0.01, 4])]
    found = limits(cameras, BALL, laid_out(cameras))
    assert found is not None
    assert found.angle == pytest.approx(0.75 * 8 + 5, abs=0.2)


def test_limits_floor_is_below_scene_and_cameras() -> None:
    cameras = arc(10)
    floor = np.c_[np.random.default_rng(1).uniform(-3, 3, (3000, 2)), np.full(3000, 0.8)][:, [0, 2, 1]]
    stray = np.array([[0, 5, 0], [1, 3, 1], [0, 900, 0]])
    found = limits(cameras, np.concatenate([BALL, floor, stray]), laid_out(cameras))
    assert found is not None
    assert found.floor == pytest.approx(-0.8, abs=0.05), "y is down, and a few points below the floor are noise"
    low = [look_at([x, 2.5, -3]) for x in (-1, 0, 1)]
    found = limits([*cameras, *low], BALL, laid_out([*cameras, *low]))
    assert found is not None
    assert found.floor == pytest.approx(-2.5), "a camera on the ground shows that one can be there"
    few = limits(cameras, BALL[:20], laid_out(cameras))
    assert few is not None
    assert few.floor is None


def test_limits_of_outward_cameras_are_none() -> None:
    outward = [look_at(c.center * 0.1, target=tuple(c.center)) for c in arc(40)]
    assert limits(outward, BALL, laid_out(outward)) is None


def test_limits_angle_is_lowered_by_failed_trial() -> None:
    cameras = arc(16, height=0.1)
    lowered, left = (limits(cameras, BALL, laid_out(cameras), most) for most in (7.5, 40.0))
    assert lowered is not None
    assert left is not None
    assert lowered.angle == 7.5
    assert left == limits(cameras, BALL, laid_out(cameras))
