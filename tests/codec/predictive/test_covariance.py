import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from splatreel.codec.predictive.covariance import LARGEST, of_shapes, to_shapes
from splatreel.scene import rotations


def covariances(quats, scales):
    axes = rotations.to_matrix(quats) * scales[:, None]
    return axes @ axes.transpose(0, 2, 1)


def random_shapes(count, spread, seed=0):
    rng = np.random.default_rng(seed)
    return rotations.normalize(rng.normal(size=(count, 4))), np.exp2(rng.normal(size=(count, 3)) * spread)


@pytest.mark.parametrize("spread", [0.0, 1e-7, 0.3, 4.0])
def test_shapes_round_trip(spread):
    quats, scales = random_shapes(500, spread)
    scales[:100, 1] = scales[:100, 0]  # round about an axis
    quats[100:150] = [1, 0, 0, 0]
    found = to_shapes(of_shapes(quats, scales))
    wanted = covariances(quats, scales)
    off = np.abs(covariances(*found) - wanted).max((1, 2)) / np.abs(wanted).max((1, 2))
    assert off.max() < 1e-7
    np.testing.assert_allclose(np.linalg.norm(found[0], axis=1), 1, atol=1e-12)


def test_shapes_do_not_depend_on_axis_order_or_sign():
    quats, scales = random_shapes(50, 1.0)
    exchanged = rotations.normalize(rotations.multiply(quats, np.array([1.0, 1.0, 1.0, 1.0])))  # x, y, z to y, z, x
    np.testing.assert_allclose(of_shapes(-exchanged, scales[:, [1, 2, 0]]), of_shapes(quats, scales), atol=1e-12)


def test_shape_numbers_known_answers():
    """Doubling all scales adds one octave per direction, which only the first number contains."""
    still = np.array([[1.0, 0, 0, 0]])
    np.testing.assert_allclose(
        of_shapes(still, np.full((1, 3), 2.0)), [[3 * np.sqrt(2 / 3), 0, 0, 0, 0, 0]], atol=1e-12
    )
    np.testing.assert_allclose(
        of_shapes(still, np.array([[4.0, 1, 1]])),
        [[2 * np.sqrt(2 / 3), np.sqrt(2), -2 / np.sqrt(6), 0, 0, 0]],
        atol=1e-12,
    )
    eighth = np.array([[np.cos(np.pi / 8), 0, 0, np.sin(np.pi / 8)]])  # 45 degrees about z
    np.testing.assert_allclose(of_shapes(eighth, np.array([[2.0, 0.5, 1]]))[0, 3:], [np.sqrt(2), 0, 0], atol=1e-12)


@given(arrays(np.float64, (3, 6), elements=st.floats(-1e12, 1e12)))
def test_any_numbers_decode_to_a_shape(numbers):
    quats, scales = to_shapes(numbers)
    assert np.isfinite(quats).all()
    assert (scales >= 2.0**-LARGEST).all()
    assert (scales <= 2.0**LARGEST).all()
    np.testing.assert_allclose(np.linalg.norm(quats, axis=1), 1, atol=1e-9)
