"""Impacts in the built-in capture's sound have correct times, delays and amplitudes."""

from pathlib import Path

import numpy as np
import pytest

from splatreel.base.progress import Silent
from splatreel.calibration.sync import synchronize
from splatreel.capture.capture_sound import RATE, choose, read_sound
from splatreel.capture.opening import open_capture
from toyroom.capture import make_cameras, make_capture
from toyroom.room import BALL_RADIUS, BALL_REACH, ball, impacts
from toyroom.sound import render_sound

SECONDS = 2.0


def onsets(sound: np.ndarray) -> list[float]:
    """Return the times in seconds at which sound starts after silence."""
    loud = np.flatnonzero(np.abs(sound) > 0.03)
    return (loud[np.diff(loud, prepend=-RATE) > RATE // 20] / RATE).tolist()


def test_impacts_coincide_with_bounces() -> None:
    times = np.arange(0, 6, 1e-3)
    x, y, _ = np.array([ball(t) for t in times]).T
    bounces = times[1:-1][(y[1:-1] <= y[:-2]) & (y[1:-1] < y[2:])]
    turns = times[1:-1][np.diff(np.sign(np.diff(x))) != 0]
    found = impacts(6)
    assert [i.time for i in found] == sorted(i.time for i in found)
    np.testing.assert_allclose([i.time for i in found if i.on == "floor"], bounces, atol=1.1e-3)
    np.testing.assert_allclose([i.time for i in found if i.on == "bumper"], turns, atol=1.1e-3)
    assert all(abs(i.place[1] - 0.012) < 1e-9 for i in found if i.on == "floor")
    assert all(abs(abs(i.place[0]) - BALL_REACH - BALL_RADIUS) < 1e-9 for i in found if i.on == "bumper")


def test_sound_is_delayed_and_attenuated() -> None:
    near, far = (render_sound(np.array([0.0, 0.7, z]), SECONDS, 0) for z in (2.75, 7.6))
    for sound, z in ((near, 2.75), (far, 7.6)):
        distances = [np.linalg.norm(np.array(i.place) - (0, 0.7, z)) for i in impacts(SECONDS)]
        expected = [i.time + d / 343 for i, d in zip(impacts(SECONDS), distances, strict=True)]
        assert onsets(sound) == pytest.approx(expected, abs=5e-4)
    assert 2 < near.std() / far.std() < 3.5
    assert np.abs(near).max() < 1


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_capture(tmp_path_factory.mktemp("room") / "room", width=16, height=16, frames=60)


def test_videos_contain_the_sound(room: Path) -> None:
    capture = open_capture(room)
    for index, camera in enumerate(make_cameras()):
        found = np.concatenate(list(read_sound(capture.tracks()[camera.name].file, 1, RATE)))
        assert np.abs(found[:, 0] - render_sound(camera.center, SECONDS, index)).max() < 1e-4, "kept without loss"
    assert choose("auto", capture.tracks(), SECONDS, 0, room).camera == "cam00", "the first within 3 dB of the loudest"


def test_sound_follows_the_frame_range(room: Path) -> None:
    capture = open_capture(room, frames=(12, 45))
    seconds, begin = capture.frames / capture.fps, capture.first_frame / capture.fps
    choice = choose("cam00", capture.tracks(), seconds, begin, room)
    found = onsets(np.concatenate(list(choice.samples(seconds)))[:, 0])
    center = capture.camera("cam00").center
    arrivals = [i.time + float(np.linalg.norm(np.array(i.place) - center)) / 343 - begin for i in impacts(SECONDS)]
    assert found == pytest.approx([time for time in arrivals if 0 < time < seconds], abs=1e-3)
    assert len(found) == 3


def test_sync_finds_zero_offsets(room: Path) -> None:
    starts = synchronize(room, Silent()).starts
    assert len(starts) == 14
    assert max(starts.values()) < 0.01, "what is left is the way of the sound"
    assert open_capture(room).frames == 60
