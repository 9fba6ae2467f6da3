"""Velocities passed from one group to the next."""

import numpy as np

from splatreel.kernels.image import render_image
from splatreel.motion.track import identity_quats
from splatreel.recon.layering.velocity_prior import VelocityPrior
from splatreel.scene.gaussians import Gaussians
from splatreel.scene.group import Group
from tests.recon.layering.test_tracking import CAMERAS, NEAR, WALL, nothing, tracked, visitor

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
