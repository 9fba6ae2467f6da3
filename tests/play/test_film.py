"""Paths through the cameras, and the film itself."""

from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest

from splatreel.capture.capture_sound import RATE, read_sound
from splatreel.kernels.image import render_image
from splatreel.play.camera_path import CameraPath, Keyframe
from splatreel.play.film import film_along_path, film_through_cameras, sound_start, write_film
from splatreel.play.timeline import open_reel
from splatreel.scene.camera import Camera
from tests import flashes
from tests.golden import GOLDEN


def camera(x: float) -> Camera:
    viewmat = np.eye(4)
    viewmat[0, 3] = -x
    return Camera(f"at {x}", viewmat, np.array([[100, 0, 32], [0, 100, 24], [0, 0, 1]]), 64, 48)


def test_film_passes_nearest_camera_first_without_jump():
    shots = film_through_cameras(camera(0), [camera(3), camera(0), camera(1), camera(2)], 31, 30, 5)
    assert [round(30 * seconds) for seconds, _ in shots] == list(range(5, 36))
    places = np.array([c.center[0] for _, c in shots])
    assert np.allclose(places[[0, 10, 20, 30]], [0, 1, 2, 3], atol=1e-4)
    assert np.abs(np.diff(places)).max() < 0.15


def test_film_keeps_lens_and_rotates_smoothly():
    turned = camera(1).viewmat.copy()
    turned[:3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
    path = [c for _, c in film_through_cameras(camera(0), [replace(camera(1), viewmat=turned)], 5, 30)]
    assert all(np.allclose(c.K, camera(0).K) for c in path)
    angles = [np.degrees(np.arccos(c.viewmat[2, 2])) for c in path]
    assert np.allclose(angles, [0, 22.5, 45, 67.5, 90], atol=1)


def test_film_without_other_cameras_does_not_move():
    for cameras in ([], [camera(0)]):
        assert [c.center[0] for _, c in film_through_cameras(camera(0), cameras, 3, 30)] == [0, 0, 0]
    assert len(film_through_cameras(camera(0), [camera(1)], 1, 30)) == 1


def test_film_along_path_has_its_duration_times_and_lens():
    keyframes = [Keyframe(t, time, camera(x).viewmat) for t, time, x in [(0.0, 1.0, 0), (1.0, 2.0, 1), (2.0, 2.0, 1)]]
    shots = film_along_path(CameraPath(keyframes), camera(9), 10)
    assert len(shots) == 21
    assert [round(seconds, 6) for seconds, _ in shots[8:13]] == [1.8, 1.9, 2.0, 2.0, 2.0]
    assert all(np.allclose(c.K, camera(9).K) for _, c in shots)
    assert shots[15][1].center[0] == 1
    assert len(film_along_path(CameraPath(keyframes, loop=True), camera(9), 10)) == 20
    assert len(film_along_path(CameraPath(keyframes[:1]), camera(9), 10)) == 1


def test_sound_start_requires_reel_speed():
    keyframes = [Keyframe(float(t), 3.0 + t, camera(t).viewmat) for t in range(3)]
    assert sound_start(film_along_path(CameraPath(keyframes), camera(0), 30), 30) == 3
    assert sound_start(film_through_cameras(camera(0), [camera(1)], 9, 30, 6), 30) == 0.2
    slow = [Keyframe(2 * k.at, k.time, k.viewmat) for k in keyframes]
    assert sound_start(film_along_path(CameraPath(slow), camera(0), 30), 30) is None


def test_film_shows_reel(tmp_path: Path):
    reel = open_reel(GOLDEN)
    start = reel.manifest.camera.resized(81, 60)
    done = []
    write_film(tmp_path / "film.mp4", reel, [(i / reel.fps, start) for i in (4, 5, 6)], report=done.append)
    assert done == [1, 2, 3]
    with av.open(str(tmp_path / "film.mp4")) as film:
        images = [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]
        assert film.streams.video[0].average_rate == reel.fps
    assert len(images) == 3
    assert images[0].shape == (60, 80, 3)
    want = np.clip(render_image(reel.at(6 / reel.fps), start), 0, 1)[:, :80]
    assert -10 * np.log10(np.mean((images[2] / 255 - want) ** 2)) > 25


def test_film_sound_is_synchronized(tmp_path: Path):
    reel = open_reel(flashes.GOLDEN)
    start, first, count = reel.manifest.camera.resized(32, 24), 50, 90
    write_film(tmp_path / "film.mp4", reel, [((first + i) / reel.fps, start) for i in range(count)])
    expected = [click - first / reel.fps for click in flashes.CLICKS[1:3]]
    sound = np.concatenate(list(read_sound(tmp_path / "film.mp4", 1, RATE)))
    np.testing.assert_allclose(flashes.onsets(sound), expected, atol=2e-3)
    assert abs(len(sound) / RATE - count / reel.fps) < 0.03
    with av.open(str(tmp_path / "film.mp4")) as film:
        light = np.array([frame.to_ndarray(format="gray").mean() for frame in film.decode(video=0)])
    rises = np.flatnonzero((light[1:] > 80) & (light[:-1] < 80)) + 1
    np.testing.assert_allclose((rises - 0.5) / reel.fps, expected, atol=1e-6)


def test_film_at_other_speed_is_silent(tmp_path: Path):
    reel = open_reel(flashes.GOLDEN)
    start = reel.manifest.camera.resized(32, 24)
    write_film(tmp_path / "film.mp4", reel, [(2 * i / reel.fps, start) for i in range(6)])
    with av.open(str(tmp_path / "film.mp4")) as film:
        assert not film.streams.audio


def test_interrupted_film_keeps_old_file(tmp_path: Path) -> None:
    def stop(done: int) -> None:
        raise KeyboardInterrupt

    (tmp_path / "film.mp4").write_bytes(b"an older film")
    reel = open_reel(GOLDEN)
    with pytest.raises(KeyboardInterrupt):
        write_film(tmp_path / "film.mp4", reel, [(0.0, reel.manifest.camera)], stop)
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [("film.mp4", b"an older film")]


def test_film_encoding_is_deterministic(tmp_path: Path) -> None:
    """One thread, and no macroblock tree: with it 22 of 7,190 encodings of the same images under load differed."""
    reel = open_reel(GOLDEN)
    for name in ("a.mp4", "b.mp4"):
        write_film(tmp_path / name, reel, [(0.0, reel.manifest.camera)] * 2)
    data = (tmp_path / "a.mp4").read_bytes()
    assert data == (tmp_path / "b.mp4").read_bytes()
    assert b" mbtree=0 " in data
    assert b" threads=1 " in data
