"""The entropy coder: round trips, its length against the entropy, damage."""

import contextlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatreel.codec import entropy
from splatreel.errors import ReelError


def coded(batches, contexts):
    encoder = entropy.Encoder(contexts)
    for values, context in batches:
        encoder.write(values, context)
    return encoder.finish()


def assert_same(batches, contexts):
    decoder = entropy.Decoder(coded(batches, contexts), contexts)
    for values, context in batches:
        np.testing.assert_array_equal(decoder.read(np.broadcast_to(context, values.shape)), values)
    decoder.finish()


@settings(deadline=None, max_examples=40)
@given(st.lists(st.tuples(st.integers(0, 300), st.integers(0, 52)), max_size=5), st.integers(0, 2**32 - 1))
def test_round_trip(sizes, seed):
    rng = np.random.default_rng(seed)
    batches = [(rng.integers(0, 1 << bits, size), rng.integers(0, 7, size)) for size, bits in sizes]
    assert_same(batches, 7)


def test_many_lanes_and_one_number_that_never_changes():
    rng = np.random.default_rng(0)
    geometric = rng.geometric(0.3, 100_000)
    assert_same([(geometric, 0), (np.full(5000, 9), 1), (geometric[:77], 0)], 2)
    assert coded([(geometric, 0)], 1)[0] > 3


def test_the_largest_numbers():
    assert_same([(np.array([0, 31, 32, 33, 63, 64, entropy.MAX_VALUE]), 0)], 1)
    with pytest.raises(ReelError, match="too large"):
        coded([(np.array([entropy.MAX_VALUE + 1]), 0)], 1)


def test_is_about_as_long_as_the_entropy():
    values = np.random.default_rng(0).geometric(0.4, 50_000)
    _, counts = np.unique(values, return_counts=True)
    ideal = -(counts * np.log2(counts / counts.sum())).sum() / 8
    assert ideal < len(coded([(values, 0)], 1)) < 1.01 * ideal + 150


def test_zigzag():
    values = np.array([0, -1, 1, -2, 2, 1 << 40, -(1 << 40)])
    assert entropy.zigzag(values)[:5].tolist() == [0, 1, 2, 3, 4]
    np.testing.assert_array_equal(entropy.unzigzag(entropy.zigzag(values)), values)


@settings(deadline=None, max_examples=200)
@given(st.data())
def test_damage_is_a_reel_error_or_decodes(data):
    values = np.random.default_rng(0).integers(0, 200, 400)
    damaged = bytearray(coded([(values, values % 3)], 3))
    for at in data.draw(st.lists(st.integers(0, len(damaged) - 1), max_size=4)):
        damaged[at] = data.draw(st.integers(0, 255))
    del damaged[data.draw(st.integers(0, 2 * len(damaged))) :]
    with contextlib.suppress(ReelError):
        decoder = entropy.Decoder(bytes(damaged), 3)
        decoder.read(values % 3)
        decoder.finish()
