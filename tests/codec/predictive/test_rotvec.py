"""Rotation vectors."""

import numpy as np

from splatreel.codec.predictive.offsets import rotation_vectors


def test_rotation_vectors_are_continuous_over_time():
    angle = np.linspace(0, 9, 40)[:, None, None]
    quats = np.concatenate([np.cos(angle / 2), np.sin(angle / 2) * [0, 0.6, 0.8]], -1)
    signs = np.where(np.arange(40) % 3 > 0, 1, -1)[:, None, None]
    np.testing.assert_allclose(rotation_vectors(quats * signs), angle * [0, 0.6, 0.8], atol=1e-9)
