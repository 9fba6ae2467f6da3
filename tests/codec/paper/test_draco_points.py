"""Positions through Draco: precision, order, coinciding points, damage."""

import contextlib
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatreel.base.errors import MissingDependencyError, ReelError
from splatreel.codec.paper import draco_points
from splatreel.play.timeline import open_reel
from splatreel.scene import morton
from tests.golden import GOLDEN, PREDICTIVE


@pytest.mark.parametrize("count", [1, 2, 3, 1000])
@pytest.mark.parametrize("offset", [0.0, 1000.0])
def test_draco_round_trip_and_order(count, offset):
    means = np.random.default_rng(count).normal(size=(count, 3)).astype(np.float32) + np.float32(offset)
    data, parameters, order = draco_points.encode_draco(means, 20)
    decoded = draco_points.decode_draco(data, parameters, count)
    assert decoded.dtype == np.float32
    assert sorted(order) == list(range(count))
    step = parameters["range"] / ((1 << 20) - 1)
    np.testing.assert_allclose(decoded, means[order], atol=0.51 * step + offset * 1e-7)
    q = np.rint((decoded.astype(np.float64) - parameters["min"]) / step)
    if not offset:
        assert (np.diff(morton.encode(q.astype(np.int64)).astype(np.int64)) > 0).all()


def test_draco_bytes_do_not_depend_on_order():
    means = np.random.default_rng(0).random((500, 3))
    data, _, order = draco_points.encode_draco(means, 20)
    assert draco_points.encode_draco(means, 20)[0] == data
    assert draco_points.encode_draco(means[::-1], 20)[0] == data
    assert draco_points.encode_draco(means[order], 20)[0] == data


def test_draco_takes_six_bytes_per_point():
    means = np.random.default_rng(0).random((20_000, 3))
    assert len(draco_points.encode_draco(means, 20)[0]) < 6.5 * len(means)


@settings(max_examples=20, deadline=None)
@given(st.integers(2, 300), st.integers(1, 40), st.integers(0, 2**32 - 1))
def test_coinciding_points_are_kept(count, places, seed):
    """Clones share their positions. None may be lost, and all stay within a few grid cells."""
    rng = np.random.default_rng(seed)
    means = rng.normal(size=(places, 3))[rng.integers(0, places, count)]
    data, parameters, order = draco_points.encode_draco(means, 20)
    decoded = draco_points.decode_draco(data, parameters, count)
    assert len(np.unique(decoded, axis=0)) == count or parameters["range"] == 1.0
    np.testing.assert_allclose(decoded, means[order], atol=20 * parameters["range"] / (1 << 20) + 1e-6)


def test_too_many_points_are_refused():
    with pytest.raises(ReelError, match="position bits"):
        draco_points.encode_draco(np.random.default_rng(0).random((5000, 3)), 4)


@pytest.mark.parametrize("bits", [3, 22])
def test_invalid_bits_are_refused(bits):
    with pytest.raises(ReelError, match="bits"):
        draco_points.encode_draco(np.zeros((2, 3)), bits)


def test_wrong_point_count_is_refused():
    data, parameters, _ = draco_points.encode_draco(np.random.default_rng(0).random((50, 3)), 16)
    with pytest.raises(ReelError, match="50 points, expected 51"):
        draco_points.decode_draco(data, parameters, 51)
    with pytest.raises(ReelError, match="range"):
        draco_points.decode_draco(data, parameters | {"range": float("nan")}, 50)


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_damaged_draco_raises_reel_error_or_decodes(seed):
    rng = np.random.default_rng(seed)
    data, parameters, _ = draco_points.encode_draco(np.random.default_rng(0).random((200, 3)), 20)
    damaged = bytearray(data)
    for at in rng.integers(0, len(data), 4):
        damaged[at] = rng.integers(0, 256)
    del damaged[rng.integers(len(data) // 2, 2 * len(data)) :]
    with contextlib.suppress(ReelError):
        assert draco_points.decode_draco(bytes(damaged), parameters, 200).shape == (200, 3)


def test_only_reels_of_the_papers_codec_need_dracopy(monkeypatch: pytest.MonkeyPatch) -> None:
    """Windows on ARM has no DracoPy."""
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    assert len(open_reel(PREDICTIVE).at(0)) > 0
    with pytest.raises(
        MissingDependencyError, match=r"h265.* needs DracoPy(.|\n)*pip install DracoPy(.|\n)*predictive"
    ):
        open_reel(GOLDEN).at(0)
