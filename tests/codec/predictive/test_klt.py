"""Karhunen-Loeve transform: reconstruction, and the order of its columns."""

import numpy as np
import pytest

from splatreel.base.errors import ReelError
from splatreel.codec.predictive import klt
from splatreel.codec.predictive.entropy import entropy_encode


def test_klt_reconstructs_low_rank_samples():
    rng = np.random.default_rng(0)
    samples = rng.normal(size=(500, 3)) @ rng.normal(size=(3, 30))
    basis, shifts = klt.analyze(samples, 0.01)
    assert basis.shape == (30, 3)
    back = klt.coefficients(samples, basis, shifts) @ klt.real(basis, shifts).T
    assert np.abs(back - samples).max() < 0.02
    np.testing.assert_array_equal(
        klt.decode_basis(klt.encode_basis(basis), {"shifts": shifts}, "shifts", 30), klt.real(basis, shifts)
    )


def test_sums_have_one_order_on_every_processor() -> None:
    """The products are exact sums one by one, whichever BLAS and however many threads NumPy has."""
    rng = np.random.default_rng(0)
    samples, matrix = rng.normal(size=(400, 5)), rng.normal(size=(5, 3))
    one_by_one = np.add.accumulate(samples[:, :, None] * samples[:, None], axis=0)[-1]
    np.testing.assert_array_equal(klt._products(samples), one_by_one)
    one_by_one = np.add.accumulate(samples[:, :, None] * matrix, axis=1)[:, -1]
    np.testing.assert_array_equal(klt._multiply(samples, matrix), one_by_one)
    np.testing.assert_array_equal(klt._products(samples[:0]), np.zeros((5, 5)))


def test_small_columns_come_last():
    found = np.ones((5, 4, 2)) * np.array([8.0, 4, 1, 2])[:, None]
    found[..., 1] /= 100
    order = klt.columns_of(found)
    assert (order % 2).tolist() == [0, 0, 0, 0, 1, 1, 1, 1]
    assert (order // 2).tolist() == [0, 1, 2, 3, 0, 1, 2, 3], "those of a channel in the order of the basis"
    data = entropy_encode(order % 2, np.zeros(8, np.int64), 1)
    np.testing.assert_array_equal(klt.decode_columns(data, 8, 4, 2), order % 2)
    for kinds, channels in ((3, 2), (4, 1)):
        with pytest.raises(ReelError, match="has columns"):
            klt.decode_columns(data, 8, kinds, channels)


def test_expand_sums_columns_by_vector_and_channel():
    basis = np.array([[1.0, 10.0], [2.0, 20.0]])  # two dimensions, two vectors
    found, columns = np.array([[1, 2, 3]], np.int32), np.array([0, 1, 0])
    whole = klt.expand(found, np.array([3]), basis, columns, 2)
    np.testing.assert_array_equal(whole[:, 0], [[1 + 30, 2], [2 + 60, 4]])
    part = klt.expand(found, np.array([2]), basis, columns, 2)
    np.testing.assert_array_equal(part[:, 0], [[1, 2], [2, 4]])
