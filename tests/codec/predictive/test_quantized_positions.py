"""Positions round trip within their steps."""

import numpy as np
import pytest

from splatreel.codec.predictive import quantized_positions


@pytest.mark.parametrize("count", [1, 2, 500])
@pytest.mark.parametrize("offset", [0.0, 1000.0])
def test_quantized_positions_round_trip(count, offset):
    means = np.random.default_rng(count).normal(size=(count, 3)) + offset
    data, parameters, order, found = quantized_positions.encode_quantized_positions(means, 0.004)
    np.testing.assert_array_equal(quantized_positions.decode_quantized_positions(data, parameters, count), found)
    bits = np.arange(count) % 4
    refinement = quantized_positions.encode_refinement_bits(means[order], parameters, found, bits)
    decoded = quantized_positions.decode_refinement_bits(refinement, parameters, found, bits)
    assert (np.abs(decoded - means[order]) <= 0.00201 * 0.5 ** bits[:, None] + 1e-7 * offset).all()
    assert len(refinement) == (3 * bits.sum() + 7) // 8


def test_coinciding_points_and_large_scenes_round_trip():
    means = np.concatenate([np.zeros((5, 3)), np.full((1, 3), 1e6)])
    data, parameters, order, _ = quantized_positions.encode_quantized_positions(means, 1e-3)
    found, bits = quantized_positions.decode_quantized_positions(data, parameters, 6), np.zeros(6, np.int64)
    decoded = quantized_positions.decode_refinement_bits(b"", parameters, found, bits)
    np.testing.assert_allclose(decoded, means[order], atol=parameters["step"])
