"""Clock and cameras of the local viewer. tests/player/test_viewer.py tests the viewer in a browser."""

import math

import numpy as np
import pytest

from splatreel.play.viewer import Clock, camera_of, place_camera
from splatreel.scene.camera import Camera


class Handle:
    """A camera of viser: a place, what it looks at, a vertical field of view."""

    position: np.ndarray
    look_at: np.ndarray
    fov: float


def test_viewer_camera_round_trip() -> None:
    viewmat = np.eye(4)
    viewmat[:3, :3] = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
    viewmat[:3, 3] = (0.2, -0.3, 4)
    K = np.array([[90, 0, 60], [0, 90, 40], [0, 0, 1]])
    given = Camera("given", viewmat, K, 120, 80)
    handle = Handle()
    place_camera(handle, given, np.zeros(3))
    assert np.allclose(handle.position, given.center, atol=1e-6)
    ahead = handle.look_at - handle.position
    assert np.allclose(ahead / np.linalg.norm(ahead), given.forward, atol=1e-6)
    assert np.linalg.norm(ahead) == pytest.approx(4)
    back = camera_of(handle.position, np.array([0.5, -0.5, -0.5, -0.5]), handle.fov, 120, 80)
    assert np.allclose(back.viewmat, given.viewmat, atol=1e-6)
    assert np.allclose(back.K, given.K, atol=1e-4)


def test_viewer_camera_without_pivot_ahead_gets_one() -> None:
    handle = Handle()
    camera = Camera("away", np.eye(4), np.diag([50.0, 50, 1]), 100, 100)
    place_camera(handle, camera, np.array([0.0, 0, -2]))  # the middle lies behind
    assert np.allclose(handle.look_at, [0, 0, 2])
    assert handle.fov == pytest.approx(2 * math.atan(1))


def test_clock_advances_at_its_rate_and_loops() -> None:
    clock = Clock(2.0, rate=0.5)
    clock.advance(1.0)
    assert clock.time == pytest.approx(0.5)
    clock.advance(4.0)
    assert (clock.time, clock.playing) == (pytest.approx(0.5), True)


def test_clock_stops_at_end_and_restarts() -> None:
    clock = Clock(2.0, loop=False)
    clock.advance(5.0)
    assert (clock.time, clock.playing) == (2.0, False)
    clock.advance(1.0)
    assert clock.time == 2.0
    clock.toggle()
    assert (clock.time, clock.playing) == (0.0, True)


def test_clock_clamps_seeks_and_stops_when_paused() -> None:
    clock = Clock(2.0)
    clock.seek(9.0)
    assert clock.time == 2.0
    clock.seek(-1.0)
    assert clock.time == 0.0
    clock.toggle()
    clock.advance(1.0)
    assert (clock.time, clock.playing) == (0.0, False)


def test_clock_of_empty_reel_stays_at_start() -> None:
    clock = Clock(0.0)
    clock.advance(1.0)
    assert clock.time == 0.0
