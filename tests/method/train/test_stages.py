"""First keyframe of a chapter: points added to and removed from the shared static points."""

import numpy as np
import pytest

from splatreel.base.progress import Silent
from splatreel.config import Config
from splatreel.kernels.image import render_image
from splatreel.method.cameras.exposure import measure_exposure, remove_exposure
from splatreel.method.cameras.group_input import GroupInput
from splatreel.method.cameras.rig import Rig
from splatreel.method.train.stages import missing_in, start_chapter
from splatreel.scene.gaussians import Gaussians, StaticPoints
from tests.method.captures import blots
from tests.method.inputs import group_input
from tests.method.scenes import look_at, ring
from tests.method.small import small

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
    """Draw a scene for all cameras, [C, H, W, 3] uint8."""
    images = np.stack([render_image(points, camera, near=NEAR) for camera in CAMERAS]) * factor * 255
    return np.rint(images + np.random.default_rng(0).normal(0, noise, images.shape)).clip(0, 255).astype(np.uint8)


def filmed(points: Gaussians, **how: float) -> GroupInput:
    """Return the input of a group with one frame of a scene."""
    return group_input(drawn(points, **how)[None], CAMERAS, near=NEAR)


def start(data: GroupInput, known: Gaussians, config: Config = CONFIG) -> tuple[Gaussians, np.ndarray]:
    """Return the new points, and which static points are kept."""
    found = start_chapter(data, static(known), config, Silent())
    assert found.alive is not None
    return found.points, found.alive


def error(points: Gaussians, truth: Gaussians) -> float:
    """Return the mean squared error of a held-out view."""
    shown, true = (render_image(scene, UNSEEN, near=NEAR).clip(0, 1) for scene in (points, truth))
    return float(np.square(shown - true).mean())


def test_unchanged_scene_adds_no_points() -> None:
    new, alive = start(filmed(BOTH, noise=3.0), BOTH)
    assert len(new) == 0
    assert alive.all()


def test_new_object_gets_points_and_static_points_stay() -> None:
    new, alive = start(filmed(BOTH), WALL)
    assert alive.mean() > 0.98, "what it hides has not gone"
    seen = new.opacities > 0.3
    low, high = THING.means.min(0) - 0.4, THING.means.max(0) + 0.4
    there = ((new.means > low) & (new.means < high)).all(1)
    assert seen.sum() > 10
    assert there[seen].mean() > 0.7
    after = error(Gaussians.concatenate([WALL, new]), BOTH)
    assert after < 0.4 * error(WALL, BOTH)


def test_removed_object_uncovers_known_points_behind_it() -> None:
    new, alive = start(filmed(WALL), BOTH)
    wall, thing = alive[: len(WALL)], alive[len(WALL) :]
    assert wall.mean() > 0.98
    assert thing.mean() < 0.1
    assert error(Gaussians.concatenate([BOTH[alive], new]), WALL) < 0.1 * error(BOTH, WALL)


def test_removed_object_gets_new_points_where_background_is_unknown() -> None:
    behind = np.all(np.abs(WALL.means[:, :2] - [-0.25, 0]) < [0.6, 0.6], axis=1)
    known = Gaussians.concatenate([WALL[~behind], THING])
    new, alive = start(filmed(WALL), known)
    left = Gaussians.concatenate([known[alive], new])
    assert error(left, WALL) < 0.5 * error(known[alive], WALL)


@pytest.mark.parametrize("factor", [0.8, 1.25])
def test_light_different_from_plates_adds_no_points(factor: float) -> None:
    wall = Gaussians(WALL.means, WALL.quats, WALL.scales, WALL.opacities, WALL.sh * 0.5)
    frames = drawn(wall, factor)[None]
    assert missing_in(group_input(frames, CAMERAS, near=NEAR), static(wall)).any()
    remove_exposure(frames, measure_exposure(Rig.of(CAMERAS), frames, drawn(wall)))
    new, alive = start(group_input(frames, CAMERAS, near=NEAR), wall)
    assert len(new) == 0
    assert alive.all()


def test_content_of_a_single_camera_adds_no_points() -> None:
    images = drawn(WALL)
    images[2, 20:40, 30:60] = 255
    new, alive = start(group_input(images[None], CAMERAS, near=NEAR), WALL)
    assert len(new) == 0
    assert alive.all()
