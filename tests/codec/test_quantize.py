"""Bit packing and linear quantization: known answers, round trips, hostile parameters."""

import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatreel.base.errors import ReelError
from splatreel.codec import quantize


def test_pack_known_answers():
    assert quantize.pack(np.array([1, 0, 1, 1]), 1) == bytes([0b1101])
    # Low bytes, then 1 and 4, low first.
    assert quantize.pack(np.array([0x123, 0x456]), 12) == bytes([0x23, 0x56, 0x41])
    assert quantize.pack(np.array([0x1234]), 16) == bytes([0x34, 0x12])
    assert quantize.pack(np.array([7, 200]), 8) == bytes([7, 200])


@settings(deadline=None)
@given(st.integers(1, 16), st.integers(0, 50), st.integers(0, 2**32 - 1))
def test_pack_round_trip(bits, count, seed):
    values = np.random.default_rng(seed).integers(0, 1 << bits, count).astype(np.uint16)
    data = quantize.pack(values, bits)
    assert len(data) == quantize.packed_size(count, bits) == -(-count * bits // 8)
    np.testing.assert_array_equal(quantize.unpack(data, bits, count), values)
    with pytest.raises(ReelError, match="bytes"):
        quantize.unpack(data + b"x", bits, count)


@settings(deadline=None)
@given(st.integers(1, 16), st.integers(1, 40), st.integers(1, 4), st.integers(0, 2**32 - 1))
def test_linear_error_is_at_most_half_a_step(bits, rows, columns, seed):
    values = np.random.default_rng(seed).normal(size=(rows, columns)) * 10.0 ** np.arange(columns)
    data, parameters = quantize.encode_linear(values, bits)
    decoded = quantize.decode_linear(data, parameters, rows, columns)
    half_step = np.ptp(values, axis=0) / ((1 << bits) - 1) / 2
    assert (np.abs(decoded - values) <= half_step + 1e-6 * np.abs(values).max(0)).all()


def test_constant_column_is_exact():
    data, parameters = quantize.encode_linear(np.full((9, 2), 0.25), 8)
    np.testing.assert_array_equal(quantize.decode_linear(data, parameters, 9, 2), 0.25)


def test_logarithms_keep_small_scales():
    """Over three decades, 12 logarithmic bits have an error of 0.1 %; 12 linear bits have an error above a point's size."""
    scales = np.exp(np.random.default_rng(0).normal(-4, 1.2, (5000, 3)))
    worst = {}
    for log in (True, False):
        data, parameters = quantize.encode_linear(scales, 12, log)
        assert parameters.get("log", False) == log
        worst[log] = np.abs(quantize.decode_linear(data, parameters, 5000, 3) / scales - 1).max()
    assert worst[True] < 2e-3
    assert worst[False] > 0.5


def test_deflate_is_used_only_if_shorter():
    assert quantize.deflate(bytes(1000))[1]
    noise = np.random.default_rng(0).bytes(1000)
    assert quantize.deflate(noise) == (noise, False)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"bits": 0}, "bits"),
        ({"bits": 17}, "bits"),
        ({"bits": True}, "bits"),
        ({"bits": "8"}, "bits"),
        ({"min": [0.0]}, "min"),
        ({"min": [float("nan"), 0.0]}, "finite"),
        ({"max": [float("inf"), 0.0]}, "finite"),
        ({"max": [10**400, 0]}, "finite"),
        ({"max": None}, "max"),
        ({"min": [9.0, 9.0]}, "above"),
        ({"log": True, "max": [1e3, 1e3]}, "logarithms"),
        ({"log": 1}, "log"),
        ({"deflate": "yes"}, "deflate"),
        ({"deflate": True}, "zlib"),
    ],
)
def test_hostile_parameters_are_refused(change, message):
    data, parameters = quantize.encode_linear(np.random.default_rng(0).random((20, 2)), 8)
    assert not parameters["deflate"]
    with pytest.raises(ReelError, match=message):
        quantize.decode_linear(data, parameters | change, 20, 2)


def test_deflate_bombs_are_refused():
    bomb = zlib.compress(bytes(50_000_000), 9)
    with pytest.raises(ReelError, match="does not inflate"):
        quantize.inflate(bomb, {"deflate": True}, 100)


@settings(deadline=None)
@given(st.lists(st.booleans(), max_size=100))
def test_bits_round_trip(flags):
    flags = np.array(flags, bool)
    data, parameters = quantize.encode_bits(flags)
    np.testing.assert_array_equal(quantize.decode_bits(data, parameters, 100), flags)


def test_huge_bit_counts_are_refused():
    with pytest.raises(ReelError, match="count"):
        quantize.decode_bits(b"", {"codec": "bits", "count": 1 << 50}, 1000)
