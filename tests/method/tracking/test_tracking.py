"""Tracking of a group: content that appears after the keyframe becomes points with tracks."""

from typing import Any

import numpy as np
import pytest

from splatreel.base.progress import Silent
from splatreel.config import LayeringConfig
from splatreel.kernels.image import render_image
from splatreel.method.layering.labels import RelitPoints
from splatreel.method.tracking import tracking
from splatreel.method.tracking.track import identity_quats
from splatreel.method.tracking.tracking import ChangeDetector, GroupStart, VelocityPrior, track
from splatreel.scene.gaussians import Gaussians, StaticPoints
from splatreel.scene.group import Group
from tests.any_threads import assert_same_on_any_threads
from tests.method.captures import blots
from tests.method.inputs import group_input
from tests.method.scenes import ring

CAMERAS = ring(5, width=96, height=64)
NEAR, FRAMES, ARRIVAL = 0.8, 6, 3
WALL = blots(900, [-5, -3.5, 0.9], [5, 3.5, 1.0], 0.2, 0)
THING = blots(40, [-1.0, -0.4, -0.2], [-0.4, 0.4, 0.2], 0.1, 1)
CENTER, RADIUS = np.array([0.6, 0.1, -0.2]), 0.3


def visitor() -> Gaussians:
    """Return a bright yellow ball with darker stripes."""
    directions = np.random.default_rng(0).normal(size=(700, 3))
    means = CENTER + RADIUS * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    shade = 1.2 + 0.4 * np.sin(12 * means.sum(1))
    sh = (shade[:, None] * [1.6, 1.4, -1.5])[:, None]
    quats = np.tile([1.0, 0, 0, 0], (len(means), 1))
    return Gaussians(means, quats, np.full(means.shape, 0.04), np.full(len(means), 0.99), sh)


def film(arrives: bool) -> np.ndarray:
    scenes = [
        Gaussians.concatenate([WALL, THING, *([visitor()] if arrives and t >= ARRIVAL else [])]) for t in range(6)
    ]
    images = [[render_image(scene, camera, near=NEAR) for camera in CAMERAS] for scene in scenes]
    return (np.clip(images, 0, 1) * 255).round().astype(np.uint8)


@pytest.fixture(scope="module")
def arrival() -> np.ndarray:
    return film(True)


def nothing(frames: np.ndarray) -> RelitPoints:
    return RelitPoints(Gaussians.empty(0), np.zeros((len(frames), 0)))


def started(frames: np.ndarray, dynamic: Gaussians = THING, static: Gaussians = WALL) -> GroupStart:
    return tracked(frames, dynamic, nothing(frames), static)


def tracked(
    frames: np.ndarray, dynamic: Gaussians, relit: RelitPoints, static: Gaussians, motion: np.ndarray | None = None
) -> GroupStart:
    living = StaticPoints(static, np.ones(len(static), bool))
    data = group_input(frames, CAMERAS, near=NEAR)
    return track(data, dynamic, relit, living, motion, LayeringConfig(), Silent())


def test_tracks_are_the_same_on_any_threads(arrival: np.ndarray) -> None:
    assert_same_on_any_threads(lambda: started(arrival))


def test_track_appends_new_points(arrival: np.ndarray) -> None:
    start = started(arrival)
    new = len(start.dynamic) - len(THING)
    assert new > 20
    assert start.tracks.shape == (FRAMES, len(start.dynamic), 3)
    np.testing.assert_array_equal(start.dynamic.means[: len(THING)], THING.means)
    np.testing.assert_allclose(start.dynamic.means, start.tracks[0], atol=1e-6)
    assert np.abs(start.tracks[:, : len(THING)] - THING.means).max() < 0.1, "the object rests"
    at_arrival = start.tracks[tracking.CHECK_EVERY, len(THING) :]
    assert np.median(np.linalg.norm(at_arrival - CENTER, axis=1)) < RADIUS + 0.1
    yellow = start.dynamic.sh[len(THING) :, 0]
    assert np.median(yellow[:, 0] - yellow[:, 2]) > 1
    assert start.dynamic.sh.shape[1] == THING.sh.shape[1]


def test_new_points_reduce_image_error(arrival: np.ndarray) -> None:
    start, last = started(arrival), FRAMES - 1
    identity = np.tile([1.0, 0, 0, 0], (len(start.dynamic), 1))
    there = start.dynamic.moved(start.tracks[last] - start.dynamic.means, identity)
    errors = []
    for scene in ([WALL, THING], [WALL, there]):
        image = render_image(Gaussians.concatenate(scene), CAMERAS[2], near=NEAR)
        errors.append(np.abs(image.clip(0, 1) - arrival[last, 2] / 255).mean())
    assert errors[1] < 0.7 * errors[0]


def test_track_adds_nothing_without_new_content() -> None:
    start = started(film(False))
    assert len(start.dynamic) == len(THING)
    assert start.tracks.shape == (FRAMES, len(THING), 3)


def test_errors_at_keyframe_add_no_points(arrival: np.ndarray) -> None:
    frames = arrival.copy()
    frames[0] = arrival[-1]
    assert len(started(frames).dynamic) == len(THING)


def test_track_rejects_new_points_above_budget(arrival: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracking, "MAX_NEW_POINTS", 5)
    start = started(arrival, THING[:3], Gaussians.concatenate([WALL, THING[3:]]))
    assert len(start.dynamic) == 3
    assert start.tracks.shape == (FRAMES, 3, 3)


def test_rejected_points_do_not_use_budget(arrival: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first check finds too many noisy points; a ball found by the second check is added."""
    frames = np.concatenate([arrival, arrival[-1:].repeat(3, 0)])
    checks, find = [], ChangeDetector.find_appeared

    def find_appeared(self: ChangeDetector, tracks: list, frame: int, masks: Any) -> tuple[Gaussians, np.ndarray]:
        checks.append(frame)
        if len(checks) > 1:
            return find(self, tracks, frame, masks)
        noise = blots(tracking.MAX_NEW_POINTS + 1, [-1, -1, 0], [1, 1, 0.5], 0.02, 3)
        return noise, np.zeros((len(noise), 3))

    monkeypatch.setattr(ChangeDetector, "find_appeared", find_appeared)
    start = started(frames)
    assert checks == [4, 8]
    assert 20 < len(start.dynamic) - len(THING) <= tracking.MAX_NEW_POINTS


def test_track_without_dynamic_points_adds_new_points(arrival: np.ndarray) -> None:
    start = started(arrival, Gaussians.empty(0), Gaussians.concatenate([WALL, THING]))
    assert len(start.dynamic) > 20
    assert start.tracks.shape == (FRAMES, len(start.dynamic), 3)


def test_track_of_few_frames_adds_no_points(arrival: np.ndarray) -> None:
    assert started(arrival[:2]).tracks.shape == (2, len(THING), 3)


def test_relit_points_rest_and_add_no_points() -> None:
    """A patch of the wall darkens. As relit points it stays in place, and no points are added."""
    patch = np.all(np.abs(WALL.means[:, :2] - [0.7, 0]) < 0.6, axis=1)
    light = np.zeros((FRAMES, patch.sum()), np.float32)
    light[2:] = -1.2
    relit, static = RelitPoints(WALL[patch], light), WALL[~patch]
    scenes = [Gaussians.concatenate([static, THING, relit.at(t)]) for t in range(FRAMES)]
    films = [[render_image(scene, camera, near=NEAR) for camera in CAMERAS] for scene in scenes]
    frames = (np.clip(films, 0, 1) * 255).round().astype(np.uint8)
    start = tracked(frames, THING, relit, static)
    assert len(start.dynamic) == len(THING) + len(relit), "no point was added"
    np.testing.assert_array_equal(start.tracks[:, len(THING) :], relit.tracks)
    np.testing.assert_array_equal(start.shades[:, len(THING) :], relit.shades)
    assert not start.shades[:, : len(THING)].any()
    assert len(started(frames).dynamic) > len(THING), "without relighting, points are added"


def test_departed_static_points_become_dynamic() -> None:
    """A ball among the static points disappears between two frames. Its points join the group, the points of the wall do not."""
    ball = visitor()
    static = Gaussians.concatenate([WALL, THING, ball])
    start = started(film(True)[::-1].copy(), Gaussians.empty(0), static)
    assert start.departed.shape == (len(static),)
    assert start.departed[-len(ball) :].mean() > 0.6
    assert start.departed[: -len(ball)].mean() < 0.02
    taken = (start.dynamic.means[:, None] == static.means[start.departed]).all(2).any(1)
    assert taken.sum() == start.departed.sum()
    assert start.tracks.shape == (FRAMES, len(start.dynamic), 3)
    np.testing.assert_array_equal(start.tracks[0, taken], start.dynamic.means[taken])


def test_resting_points_do_not_depart() -> None:
    assert not started(film(False), Gaussians.empty(0), Gaussians.concatenate([WALL, THING])).departed.any()


STEP = np.array([-0.45, 0, 0], np.float32)
"""Three quarters of the ball's width per frame."""


def thrown() -> Group:
    """Return a ball that flies through five frames."""
    ball = visitor()
    dx = np.arange(5, dtype=np.float32)[:, None, None] * STEP * np.ones((len(ball), 1), np.float32)
    dq = np.repeat(identity_quats(len(ball))[None], 5, axis=0)
    return Group(0, 0, ball, dx, dq, np.ones(len(WALL), bool))


def test_velocity_prior_uses_nearest_point_within_limit() -> None:
    velocity = VelocityPrior.of(thrown(), 3)
    near = thrown().at(3).means[::7] + 0.005
    np.testing.assert_allclose(velocity.at(near, unit=4.0), np.tile(STEP, (len(near), 1)), atol=1e-5)
    assert not velocity.at(near + 1, unit=4.0).any()


def test_velocity_prior_without_points() -> None:
    velocity = VelocityPrior(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32))
    assert velocity.at(np.ones((4, 3), np.float32), unit=1.0).shape == (4, 3)


def test_velocity_prior_improves_tracking_of_fast_ball() -> None:
    group = thrown()
    scenes = [Gaussians.concatenate([WALL, group.at(frame)]) for frame in (1, 2, 3)]
    images = [[render_image(scene, camera, near=NEAR) for camera in CAMERAS] for scene in scenes]
    frames = (np.clip(images, 0, 1) * 255).round().astype(np.uint8)
    ball = group.at(1)

    def off(motion: np.ndarray | None) -> float:
        start = tracked(frames, ball, nothing(frames), WALL, motion)
        return float(np.linalg.norm(start.tracks[1, : len(ball)] - group.at(2).means, axis=1).mean())

    known, unknown = off(VelocityPrior.of(group, 1).at(ball.means, unit=4.0)), off(None)
    assert known < 0.05
    assert known < 0.5 * unknown
