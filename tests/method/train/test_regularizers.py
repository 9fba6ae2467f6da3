"""Nearest neighbors of points."""

import numpy as np

from splatreel.method.train.regularizers import Neighbors


def test_neighbors_are_ranked_and_weighted_by_distance():
    means = np.array([[0, 0, 0], [1, 0, 0], [3, 0, 0], [3, 0.1, 0]], np.float32)
    found = Neighbors.of(means, 8)
    assert found is not None
    assert found.index.shape == found.closeness.shape == (3, 4)
    assert found.closeness.dtype == np.float32
    assert found.index[0].tolist() == [1, 0, 3, 2]
    assert (found.closeness[0] > found.closeness[2]).all()
    assert Neighbors.of(means[:1], 8) is None
