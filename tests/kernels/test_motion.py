"""Splines, offsets and the as-rigid-as-possible loss: known answers."""

import numpy as np
import pytest

from splatreel.kernels import motion
from splatreel.scene import rotations
from tests.kernels.cases import WEIGHTS, moving, normal


def test_points_move_with_their_nodes_and_on_their_own():
    (nodes, points), skin = moving(5, 90)
    dx, dq = motion.offsets(nodes[:4], points[:4], WEIGHTS, skin, 2.5)
    values = np.tensordot(WEIGHTS, points[:4], 1) + np.einsum(
        "nk,nkd->nd", skin[1], np.tensordot(WEIGHTS, nodes[:4], 1)[skin[0]]
    )
    np.testing.assert_allclose(dx, 2.5 * values[:, :3], rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(dq, values[:, 3:] + [1, 0, 0, 0], rtol=1e-4, atol=1e-5)


def test_product_sum_is_the_change_along_the_gradient():
    controls, slopes = normal(3, 700, 7), normal(700, 7, seed=1)
    expected = np.einsum("k,krd,rd->", WEIGHTS[:3].astype(float), controls.astype(float), slopes.astype(float))
    assert motion.product_sum(controls, WEIGHTS[:3], slopes) == pytest.approx(expected, rel=1e-4)


def test_rigid_motion_costs_nothing():
    """If all points turn about one center and move on together, neither pairs nor distances change."""
    means, neighbor = normal(60, 3), np.random.RandomState(0).randint(60, size=60)
    turn = rotations.normalize(np.array([[0.9, 0.2, -0.1, 0.3]]))
    moved = means @ rotations.to_matrix(turn)[0].T + np.array([0.3, -0.1, 0.2])
    dx, dq = (moved - means).astype(np.float32), np.repeat(turn.astype(np.float32), 60, 0)
    weights = np.ones(60, np.float32)
    rigid, *_ = motion.arap(means, dx, dq, neighbor, weights, 1.0)
    assert rigid < 1e-5
    apart, *_ = motion.arap(means, 2 * dx, dq, neighbor, weights, 1.0)
    assert apart > 0.1
