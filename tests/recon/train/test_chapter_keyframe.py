"""What the first frame of a chapter adds to static points that are known, and what it takes away."""

import numpy as np
import pytest

from splatreel.config import Config
from splatreel.kernels.image import render_image
from splatreel.progress import Silent
from splatreel.recon.cameras.exposure import measure_exposure, remove_exposure
from splatreel.recon.cameras.group_input import GroupInput
from splatreel.recon.cameras.rig import Rig
from splatreel.recon.train.chapter_keyframe import ChapterStart, missing_in, start_chapter
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.static_points import StaticPoints
from tests.recon.captures import blots
from tests.recon.inputs import group_input
from tests.recon.scenes import look_at, ring
from tests.recon.small import small

WIDTH, HEIGHT = 96, 64
CAMERAS = ring(6, width=WIDTH, height=HEIGHT)
UNSEEN = look_at([0.3, 0.1, -3.95], width=WIDTH, height=HEIGHT)
WALL = blots(900, [-3.5, -2.5, 0.95], [3.5, 2.5, 1.0], 0.12, 0)
THING = blots(60, [-0.6, -0.5, -0.4], [0.2, 0.5, 0.1], 0.1, 1)
BOTH = Gaussians.concatenate([WALL, THING])
NEAR = 0.5
CONFIG = small({"keyframe.first_iterations": 60, "keyframe.sh_degree": 0})


def static(points: Gaussians) -> StaticPoints:
    return StaticPoints.none(0).with_layer(points)


def drawn(points: Gaussians, factor: float = 1.0, noise: float = 0.0) -> np.ndarray:
    """[C, H, W, 3] uint8."""
    images = np.stack([render_image(points, camera, near=NEAR) for camera in CAMERAS]) * factor * 255
    return np.rint(images + np.random.default_rng(0).normal(0, noise, images.shape)).clip(0, 255).astype(np.uint8)


def filmed(points: Gaussians, **how: float) -> GroupInput:
    """One frame of a scene."""
    return group_input(drawn(points, **how)[None], CAMERAS, near=NEAR)


def start(data: GroupInput, known: Gaussians, config: Config = CONFIG) -> ChapterStart:
    return start_chapter(data, static(known), config, Silent())


def error(points: Gaussians, truth: Gaussians) -> float:
    """Mean square, of a view that no camera has."""
    shown, true = (render_image(scene, UNSEEN, near=NEAR).clip(0, 1) for scene in (points, truth))
    return float(np.square(shown - true).mean())


def test_where_nothing_has_changed_there_is_nothing_to_add() -> None:
    found = start(filmed(BOTH, noise=3.0), BOTH)
    assert len(found.points) == 0
    assert found.alive.all()


def test_what_has_appeared_gets_points_where_it_is_and_all_that_was_there_stays() -> None:
    found = start(filmed(BOTH), WALL)
    assert found.alive.mean() > 0.98, "what it hides has not gone"
    seen = found.points.opacities > 0.3
    low, high = THING.means.min(0) - 0.4, THING.means.max(0) + 0.4
    there = ((found.points.means > low) & (found.points.means < high)).all(1)
    assert seen.sum() > 10
    assert there[seen].mean() > 0.7
    after = error(Gaussians.concatenate([WALL, found.points]), BOTH)
    assert after < 0.4 * error(WALL, BOTH)


def test_what_has_gone_is_taken_out_and_what_is_known_behind_it_shows() -> None:
    found = start(filmed(WALL), BOTH)
    wall, thing = found.alive[: len(WALL)], found.alive[len(WALL) :]
    assert wall.mean() > 0.98
    assert thing.mean() < 0.1
    assert error(Gaussians.concatenate([BOTH[found.alive], found.points]), WALL) < 0.1 * error(BOTH, WALL)


def test_where_nobody_has_seen_what_is_behind_what_has_gone_new_points_fill_the_hole() -> None:
    behind = (np.abs(WALL.means[:, :2] - [-0.25, 0]) < [0.6, 0.6]).all(1)
    known = Gaussians.concatenate([WALL[~behind], THING])
    found = start(filmed(WALL), known)
    left = Gaussians.concatenate([known[found.alive], found.points])
    assert error(left, WALL) < 0.5 * error(known[found.alive], WALL)


@pytest.mark.parametrize("factor", [0.8, 1.25])
def test_light_that_is_another_than_in_the_plates_is_taken_out_and_adds_nothing(factor: float) -> None:
    wall = Gaussians(WALL.means, WALL.quats, WALL.scales, WALL.opacities, WALL.sh * 0.5)
    frames = drawn(wall, factor)[None]
    assert missing_in(group_input(frames, CAMERAS, near=NEAR), static(wall)).any()
    remove_exposure(frames, measure_exposure(Rig.of(CAMERAS), frames, drawn(wall)))
    found = start(group_input(frames, CAMERAS, near=NEAR), wall)
    assert len(found.points) == 0
    assert found.alive.all()


def test_what_one_camera_alone_sees_is_nothing_that_is_there() -> None:
    images = drawn(WALL)
    images[2, 20:40, 30:60] = 255
    found = start(group_input(images[None], CAMERAS, near=NEAR), WALL)
    assert len(found.points) == 0
    assert found.alive.all()
