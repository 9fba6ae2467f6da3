"""A small sequence of Gaussians: a static wall, and a ball that flies past it and rotates."""

from pathlib import Path

import numpy as np

from splatreel.formats.ply import write_ply
from splatreel.scene import rotations
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians
from tests.golden import random_gaussians

WALL, BALL = 300, 150


def scene(seed: int = 0) -> Gaussians:
    """Return the wall's points, then the ball's, SH degree 1, about a unit in size."""
    rng = np.random.default_rng(seed)
    spread = np.concatenate([rng.uniform(-2, 2, (WALL, 2)), rng.uniform(1.5, 2.5, (WALL, 1))], 1)
    points = random_gaussians(rng, WALL + BALL, 1, (0, 0, 0))
    means = points.means.copy()
    means[:WALL] = spread
    means[WALL:] *= 0.4
    scales = rng.uniform(0.05, 0.12, (WALL + BALL, 3))
    opacities = np.full(WALL + BALL, 0.9)
    return Gaussians(means, points.quats, scales, opacities, 0.5 * points.sh)


def frame(number: int) -> Gaussians:
    """Return a frame: the ball moves by 0.05 along x and rotates by 3 degrees about y per frame."""
    points = scene()
    ball = points[WALL:]
    half = np.radians(3 * number) / 2
    turn = np.broadcast_to(np.array([np.cos(half), 0, np.sin(half), 0]), (BALL, 4))
    turned = (rotations.to_matrix(turn) @ ball.means[..., None])[..., 0] + [0.05 * number - 0.5, 0, 0]
    moved = Gaussians(turned, rotations.multiply(turn, ball.quats), ball.scales, ball.opacities, ball.sh)
    return Gaussians.concatenate([points[:WALL], moved])


def write_film(folder: Path, frames: list[Gaussians]) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for number, points in enumerate(frames):
        write_ply(folder / f"frame{number:04}.ply", points)
    return folder


def cameras(count: int = 5) -> list[Camera]:
    """Return cameras on an arc in front of the wall, 96 x 72 pixels."""
    found = []
    for k, angle in enumerate(np.linspace(-0.5, 0.5, count)):
        turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
        viewmat = np.eye(4)
        viewmat[:3, :3], viewmat[:3, 3] = turn, [0, 0, 4]
        found.append(Camera(f"cam{k}", viewmat, np.array([[80, 0, 48], [0, 80, 36], [0, 0, 1.0]]), 96, 72))
    return found
