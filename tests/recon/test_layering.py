import numpy as np

from splatreel.recon.layering import separate
from tests.recon.scenes import random_gaussians


def test_points_change_layer_by_their_labels():
    static, dynamic = random_gaussians(6, seed=0), random_gaussians(4, seed=1)
    alive = np.array([True, False, True, True, True, False])
    moves = np.array([False, True, False, False, True, False, True, True])
    layers = separate(static, alive, dynamic, moves)
    assert layers.alive.tolist() == [True, False, False, True, True, False]
    np.testing.assert_array_equal(layers.settled.means, dynamic.means[[1]])
    np.testing.assert_array_equal(layers.dynamic.means, np.concatenate([dynamic.means[[0, 2, 3]], static.means[[2]]]))


def test_nothing_moves_and_everything_moves():
    static, dynamic = random_gaussians(3), random_gaussians(2, seed=1)
    alive = np.ones(3, bool)
    still = separate(static, alive, dynamic, np.zeros(5, bool))
    assert (len(still.dynamic), len(still.settled), still.alive.sum()) == (0, 2, 3)
    moving = separate(static, alive, dynamic, np.ones(5, bool))
    assert (len(moving.dynamic), len(moving.settled), moving.alive.sum()) == (5, 0, 0)
