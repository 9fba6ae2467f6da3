"""Entropy coder: round trips, length compared with the entropy, damage."""

import contextlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

from splatreel.base.errors import ReelError
from splatreel.codec.predictive import entropy


def coded(values, contexts, count):
    return entropy.entropy_encode(values, np.broadcast_to(contexts, values.shape), count)


@njit
def decoded(contexts, lookup, states, words, raw, cursor):
    values = np.empty(len(contexts), np.int64)
    for i in range(len(contexts)):
        values[i] = entropy.take(contexts[i], lookup, states, words, raw, cursor)
    return values


def assert_same(values, contexts, count):
    contexts = np.broadcast_to(contexts, values.shape).astype(np.int64)
    stream = entropy.Stream(coded(values, contexts, count), count)
    np.testing.assert_array_equal(decoded(contexts, *stream.parts), values)
    stream.finish()


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 1500), st.integers(0, 52), st.integers(0, 2**32 - 1))
def test_entropy_round_trip(size, bits, seed):
    rng = np.random.default_rng(seed)
    assert_same(rng.integers(0, 1 << bits, size), rng.integers(0, 7, size), 7)


def test_constant_numbers_round_trip_in_lanes():
    rng = np.random.default_rng(0)
    geometric = rng.geometric(0.3, 100_000)
    assert_same(np.concatenate([geometric, np.full(5000, 9)]), np.repeat([0, 1], [100_000, 5000]), 2)
    assert [coded(geometric[:count], 0, 1)[0] for count in (10, 100_000)] == [0, 2]


def test_stream_of_one_context_is_read_in_one_call():
    values = np.random.default_rng(0).integers(0, 1 << 20, 3000)
    stream = entropy.Stream(coded(values, 0, 1), 1)
    np.testing.assert_array_equal(np.concatenate([stream.read(1000), stream.read(2000)]), values)
    stream.finish()
    stream.read(100)
    with pytest.raises(ReelError, match="damaged"):
        stream.finish()


def test_largest_numbers_round_trip():
    assert_same(np.array([0, 31, 32, 33, 63, 64, entropy.MAX_VALUE]), 0, 1)
    with pytest.raises(ReelError, match="too large"):
        coded(np.array([entropy.MAX_VALUE + 1]), 0, 1)


def test_stream_length_is_near_the_entropy():
    values = np.random.default_rng(0).geometric(0.4, 50_000)
    _, counts = np.unique(values, return_counts=True)
    ideal = -(counts * np.log2(counts / counts.sum())).sum() / 8
    assert ideal < len(coded(values, 0, 1)) < 1.01 * ideal + 150


def test_zigzag():
    values = np.array([0, -1, 1, -2, 2, 1 << 40, -(1 << 40)])
    assert entropy.zigzag(values)[:5].tolist() == [0, 1, 2, 3, 4]
    np.testing.assert_array_equal(entropy.unzigzag(entropy.zigzag(values)), values)


@settings(deadline=None, max_examples=200)
@given(st.data())
def test_damaged_stream_raises_reel_error_or_decodes(data):
    values = np.random.default_rng(0).integers(0, 200, 400)
    damaged = bytearray(coded(values, values % 3, 3))
    for at in data.draw(st.lists(st.integers(0, len(damaged) - 1), max_size=4)):
        damaged[at] = data.draw(st.integers(0, 255))
    del damaged[data.draw(st.integers(0, 2 * len(damaged))) :]
    with contextlib.suppress(ReelError):
        stream = entropy.Stream(bytes(damaged), 3)
        decoded(values % 3, *stream.parts)
        stream.finish()
