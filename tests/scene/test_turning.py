"""Rotation of Gaussians: directions, shapes and colors turn together."""

import numpy as np
import pytest

from splatreel.scene import rotations
from splatreel.scene.turning import turn_between, turn_upright, turned
from tests.golden import random_gaussians

CENTER = (1.0, -2.0, 3.0)


@pytest.mark.parametrize(
    ("start", "end"),
    [
        ((0, -1, 0), (0, 1, 0)),
        ((0, 1, 0), (0, 1, 0)),
        ((1, 0, 0), (-1, 0, 0)),
        ((0, 0, 2), (0, -1, 0)),
        ((0.3, -0.5, 0.1), (1, 2, 3)),
    ],
)
def test_direction_is_turned_to_another(start: tuple[float, ...], end: tuple[float, ...]) -> None:
    found = rotations.to_matrix(turn_between(np.array(start), np.array(end))) @ np.array(start)
    np.testing.assert_allclose(found / np.linalg.norm(start), np.array(end) / np.linalg.norm(end), atol=1e-9)


def test_opposite_directions_are_half_a_turn_about_x() -> None:
    assert turn_between(np.array([0, -1, 0]), np.array([0, 1, 0])).tolist() == [0, 1, 0, 0]


def color(sh: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Return colors [N, 3] as 3DGS computes them, without clipping."""
    x, y, z = direction
    basis = [0.28209479177387814, *(0.4886025119029199 * np.array([-y, z, -x]))]
    two = np.array(
        [1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396]
    )
    basis += (two * [x * y, y * z, 2 * z * z - x * x - y * y, x * z, x * x - y * y]).tolist()
    three = [-0.5900435899266435, 2.890611442640554, -0.4570457994644658, 0.3731763325901154]
    three += [-0.4570457994644658, 1.445305721320277, -0.5900435899266435]
    last = [y * (3 * x * x - y * y), x * y * z, y * (4 * z * z - x * x - y * y)]
    last += [z * (2 * z * z - 3 * x * x - 3 * y * y), x * (4 * z * z - x * x - y * y), z * (x * x - y * y)]
    basis += (np.array(three) * [*last, x * (x * x - 3 * y * y)]).tolist()
    return np.einsum("k,nkc->nc", np.array(basis)[: sh.shape[1]], sh) + 0.5


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("quat", [(0, 1, 0, 0), (0.8, -0.1, 0.5, 0.3)])
def test_scene_looks_the_same_from_a_turned_viewpoint(degree: int, quat: tuple[float, ...]) -> None:
    points = random_gaussians(np.random.default_rng(degree), 30, degree, CENTER)
    turn = np.array(quat) / np.linalg.norm(quat)
    matrix, found = rotations.to_matrix(turn), turned(points, turn)
    np.testing.assert_allclose(found.means, points.means @ matrix.T, atol=1e-5)
    axes, before = rotations.to_matrix(found.quats), rotations.to_matrix(points.quats)
    np.testing.assert_allclose(axes, matrix @ before, atol=1e-5)
    for direction in np.eye(3)[[0, 1, 2]]:
        np.testing.assert_allclose(color(found.sh, matrix @ direction), color(points.sh, direction), atol=1e-4)


def test_slightly_tilted_scenes_keep_the_same_side_in_front() -> None:
    up = np.array([0.01, -1, -0.008])
    down, upward = (turn_upright(up, np.array([0.0, sign, 0])) for sign in (-1, 1))
    half = rotations.multiply(np.array([0.0, 1, 0, 0]), down)
    np.testing.assert_allclose(np.abs(half @ upward), 1, atol=1e-9)
    np.testing.assert_allclose(rotations.to_matrix(upward) @ up / np.linalg.norm(up), [0, 1, 0], atol=1e-9)
