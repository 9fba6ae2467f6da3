"""Quaternions against rotation matrices."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from splatreel.scene import rotations

seeds = st.integers(0, 2**32 - 1)


def random_quats(seed, count=8):
    return rotations.normalize(np.random.default_rng(seed).normal(size=(count, 4)))


def test_multiply_and_to_matrix_known_answers():
    half = np.sqrt(0.5)
    z90 = np.array([half, 0, 0, half])
    np.testing.assert_allclose(rotations.to_matrix(z90), [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)
    np.testing.assert_allclose(rotations.multiply(z90, z90), [0, 0, 0, 1], atol=1e-12)
    np.testing.assert_array_equal(rotations.normalize(np.zeros((2, 4))), [[1, 0, 0, 0]] * 2)


@settings(deadline=None)
@given(seeds)
def test_to_matrix_agrees_with_scipy(seed):
    quats = random_quats(seed)
    expected = Rotation.from_quat(quats[:, [1, 2, 3, 0]]).as_matrix()
    np.testing.assert_allclose(rotations.to_matrix(quats), expected, atol=1e-10)


@settings(deadline=None)
@given(seeds)
def test_product_of_quaternions_is_product_of_matrices(seed):
    a, b = random_quats(seed), random_quats(seed + 1)
    product = rotations.to_matrix(rotations.multiply(a, b))
    np.testing.assert_allclose(product, rotations.to_matrix(a) @ rotations.to_matrix(b), atol=1e-10)


@settings(deadline=None)
@given(seeds)
def test_normalize_returns_unit_quaternions(seed):
    quats = np.random.default_rng(seed).normal(size=(5, 3, 4))
    unit = rotations.normalize(quats)
    np.testing.assert_allclose(np.linalg.norm(unit, axis=-1), 1)
    np.testing.assert_allclose(np.cross(unit[..., 1:], quats[..., 1:]), 0, atol=1e-12)
