"""The scene keeps the properties that its benchmarks need: motion times and speeds."""

import numpy as np
import pytest

from splatreel.scene.camera import Camera
from toyroom import room as toys
from toyroom.capture import make_cameras
from toyroom.raytracer import trace_cover, trace_static
from toyroom.solids import END, FIRST, OCCLUSION, POSITION, REACH

GLOBE, BALL, PLANE, TRAIN = range(4)


def place(body: int, frame: float) -> np.ndarray:
    return toys.moving(frame / 30).bodies[body, :3]


def on_screen(camera: Camera, point: np.ndarray) -> np.ndarray:
    x, y, z = camera.K @ (camera.viewmat[:3, :3] @ point + camera.viewmat[:3, 3])
    return np.array([x, y]) / z


def test_train_starts_in_the_second_group() -> None:
    first = slice(*toys.moving(0).bodies[TRAIN, [FIRST, END]].astype(int))
    assert not toys.in_motion(35 / 30)[first].any()
    assert toys.in_motion(37 / 30)[first].all()
    np.testing.assert_array_equal(place(TRAIN, 0), place(TRAIN, 36))
    assert np.linalg.norm(place(TRAIN, 59) - place(TRAIN, 36)) > 0.2


def test_globe_turns_in_place() -> None:
    assert toys.in_motion(0.1)[0]
    np.testing.assert_array_equal(place(GLOBE, 0), place(GLOBE, 50))


def test_ball_is_fast() -> None:
    camera = make_cameras()[0]
    steps = [
        np.linalg.norm(on_screen(camera, place(BALL, t + 1)) - on_screen(camera, place(BALL, t))) for t in range(59)
    ]
    assert 5 < np.median(steps) < 9


def test_ball_stays_within_its_bounds() -> None:
    for t in range(300):
        x, y, _ = place(BALL, t)
        assert abs(x) < 1.5
        assert y > 0.16


def test_plane_enters_in_the_first_group() -> None:
    still, moving = toys.standing(), {frame: toys.moving(frame / 30) for frame in (3, 20)}
    first, end = moving[3].bodies[PLANE, [FIRST, END]].astype(int)
    plane = np.zeros(len(moving[3].solids), bool)
    plane[first:end] = True
    for camera in make_cameras(64, 48):
        seen = trace_static(camera, still, toys.LIGHT)
        assert trace_cover(camera, seen, moving[3], plane)[0].sum() == 0
        assert trace_cover(camera, seen, moving[20], plane)[0].sum() > 20


def test_motion_is_continuous_except_bounces() -> None:
    for t in np.linspace(0, 8, 500):
        now, soon = toys.moving(t), toys.moving(t + 1e-4)
        assert np.abs(now.bodies[:, :3] - soon.bodies[:, :3]).max() < 1e-3


def test_every_solid_is_inside_its_body() -> None:
    for shapes in (toys.standing(0), toys.moving(1.0)):
        for body in shapes.bodies:
            part = shapes.solids[int(body[FIRST]) : int(body[END])]
            gap = np.linalg.norm(part[:, POSITION : POSITION + 3] - body[:3], axis=1) + part[:, REACH]
            assert gap.max() <= body[3] + 1e-9


@pytest.mark.parametrize("seed", [0, 1])
def test_same_seed_gives_the_same_scene(seed: int) -> None:
    np.testing.assert_array_equal(toys.standing(seed).solids, toys.standing(seed).solids)
    assert (toys.standing(seed).solids != toys.standing(seed + 1).solids).any()
    assert (toys.standing(seed).solids[:, OCCLUSION] >= 0).all()
