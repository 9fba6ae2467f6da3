"""Prediction from neighbors: levels, error bounds, savings, damage."""

import contextlib
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatreel.base.errors import ReelError
from splatreel.codec.predictive import lod_prediction
from splatreel.scene import morton


def quantized(count, seed=0, bits=12):
    q = np.random.default_rng(seed).integers(0, 1 << bits, (count, 3))
    return q[np.argsort(morton.encode(q), kind="stable")]


@pytest.mark.parametrize("count", [1, 2, 63, 64, 127, 128, 129, 1000])
def test_each_point_has_one_level_and_coarser_neighbors(count):
    levels = lod_prediction.levels_of(quantized(count))
    known = np.zeros(count, bool)
    assert 1 <= levels.starts[1] < 2 * lod_prediction.FIRST_LEVEL
    assert (levels.weights[: levels.starts[1]] == 0).all()
    for first, end in pairwise(levels.starts):
        weights, near = levels.weights[first:end], levels.neighbors[first:end]
        assert known[near[weights > 0]].all()
        assert first == 0 or (weights.sum(1) == 4096).all()
        assert (weights >= 0).all()
        assert not known[levels.order[first:end]].any()
        known[levels.order[first:end]] = True
    assert known.all()


def plain_nearest(q, point, stride):
    """Return neighbors and weights of a point as the format defines them, without compilation."""
    middle = point // stride
    there = [j * stride for j in range(middle - 7, middle + 9) if 0 <= j * stride < len(q)]
    near = sorted(there, key=lambda other: ((q[other] - q[point]) ** 2).sum())[:4]
    n = [1 / (1 + np.sqrt(float(((q[other] - q[point]) ** 2).sum()))) for other in near] + [0.0] * (4 - len(near))
    total = ((n[0] + n[1]) + n[2]) + n[3]
    weights = [int(np.floor(n_k * 4096 / total)) for n_k in n]
    weights[0] = 4096 - sum(weights[1:])
    return near, weights


def test_neighbors_match_the_format():
    q = quantized(700, bits=3)  # many are equally near
    levels = lod_prediction.levels_of(q)
    for level, (first, end) in enumerate(pairwise(levels.starts)):
        stride = 2 ** (len(levels.starts) - 1 - level)
        for place in range(first, end, 7) if level else ():
            near, weights = plain_nearest(q, levels.order[place], stride)
            assert levels.neighbors[place, : len(near)].tolist() == near
            assert levels.weights[place].tolist() == weights


def test_neighbors_are_near():
    q = quantized(2000)
    levels = lod_prediction.levels_of(q)
    last = slice(levels.starts[-2], None)
    near = np.linalg.norm(q[levels.neighbors[last, 0]] - q[levels.order[last]], axis=1)
    assert np.median(near) < 0.6 * np.median(np.linalg.norm(q[1::2] - q[::-1][1::2], axis=1))
    assert (levels.weights[:, 0] >= levels.weights[:, 3]).all()


@settings(deadline=None, max_examples=25)
@given(st.integers(1, 400), st.integers(1, 5), st.floats(0.1, 1e5), st.integers(0, 2**32 - 1))
def test_lod_round_trip_within_the_error_bound(count, columns, size, seed):
    rng = np.random.default_rng(seed)
    values, classes = rng.normal(size=(count, columns)) * size, rng.integers(0, lod_prediction.MAX_CLASS + 1, count)
    levels = lod_prediction.levels_of(quantized(count, seed))
    data, found = lod_prediction.encode_lod(values, levels, classes)
    assert (np.abs(found - values) <= (1 - lod_prediction.DEAD_ZONE) * 2.0 ** classes[:, None] + 1e-6).all()
    np.testing.assert_array_equal(lod_prediction.decode_lod(data, values.shape, levels, classes), found)


@settings(deadline=None, max_examples=25)
@given(st.integers(1, 400), st.integers(1, 6), st.floats(0.1, 1e3), st.integers(0, 2**32 - 1))
def test_columns_past_the_end_are_zero(count, columns, size, seed):
    rng = np.random.default_rng(seed)
    values, classes = rng.laplace(size=(count, columns)) * size, rng.integers(0, lod_prediction.MAX_CLASS + 1, count)
    levels, ends = lod_prediction.levels_of(quantized(count, seed)), lod_prediction.ends_of(values, classes)
    data, found = lod_prediction.encode_lod(values, levels, classes, ends)
    past = np.arange(columns) >= ends[:, None]
    assert (found[past] == 0).all()
    assert (np.abs(found - values) <= (1 - lod_prediction.DEAD_ZONE) * 2.0 ** classes[:, None] + 1e-6).all()
    np.testing.assert_array_equal(lod_prediction.decode_lod(data, values.shape, levels, classes, ends), found)


def test_smooth_values_cost_little():
    q = quantized(3000)
    levels, flat = lod_prediction.levels_of(q), np.zeros(3000, np.int64)
    smooth = np.sin(q / 2000) * 300
    shuffled = np.random.default_rng(0).permutation(smooth)
    sizes = [len(lod_prediction.encode_lod(values, levels, flat)[0]) for values in (smooth, shuffled)]
    assert sizes[0] < 0.75 * sizes[1]


def test_too_large_values_are_refused():
    levels = lod_prediction.levels_of(quantized(5))
    with pytest.raises(ReelError, match="coarser step"):
        lod_prediction.encode_lod(np.full((5, 1), 1e12), levels, np.zeros(5, np.int64))


@settings(deadline=None, max_examples=100)
@given(st.data())
def test_damaged_lod_data_raises_reel_error_or_decodes(data):
    levels, classes = lod_prediction.levels_of(quantized(150)), np.zeros(150, np.int64)
    damaged = bytearray(
        lod_prediction.encode_lod(np.random.default_rng(0).normal(size=(150, 2)) * 40, levels, classes)[0]
    )
    for at in data.draw(st.lists(st.integers(0, len(damaged) - 1), max_size=4)):
        damaged[at] = data.draw(st.integers(0, 255))
    with contextlib.suppress(ReelError):
        assert lod_prediction.decode_lod(bytes(damaged), (150, 2), levels, classes).shape == (150, 2)
