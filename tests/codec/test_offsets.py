"""Offset codecs: precision, layout, determinism, damage."""

import contextlib
import dataclasses
import io

import av
import numpy as np
import pytest

from splatreel.codec import h265, offsets
from splatreel.config import EncodeConfig
from splatreel.errors import ReelError
from splatreel.scene import rotations
from tests.golden import random_gaussians, random_motion

CONFIG = EncodeConfig(codec="h265")


def motion(count, frames, seed=0):
    rng = np.random.default_rng(seed)
    return random_motion(rng, random_gaussians(rng, count, 0, (0, 0, 0)), frames)


def angles(a, b):
    """Degrees between rotations."""
    return np.degrees(2 * np.arccos(np.clip(np.abs((a * b).sum(-1)), 0, 1)))


@pytest.mark.parametrize(("count", "frames"), [(1, 1), (1, 5), (300, 1), (700, 8)])
@pytest.mark.parametrize("fold", [True, False])
def test_round_trip(count, frames, fold):
    dx, dq = motion(count, frames)
    data, parameters = offsets.encode(dx, dq, dataclasses.replace(CONFIG, fold=fold))
    got_dx, got_dq = offsets.decode(data, parameters, frames, count)
    assert (got_dx.dtype, got_dq.dtype) == (np.float32, np.float32)
    extent = np.ptp(dx, axis=(0, 1)).max()
    assert np.abs(got_dx - dx).max() <= 256 / 65535 * extent + 1e-6  # the high byte is lossless
    assert np.sqrt(((got_dx - dx) ** 2).mean()) < 5e-4 * extent + 1e-6
    assert angles(got_dq, dq).mean() < 2
    np.testing.assert_allclose(np.linalg.norm(got_dq, axis=-1), 1, atol=1e-5)


def test_same_offsets_same_bytes():
    dx, dq = motion(300, 4)
    assert offsets.encode(dx, dq, CONFIG) == offsets.encode(dx, dq, CONFIG)


def test_quaternion_signs_do_not_matter():
    dx, dq = motion(200, 4)
    flipped = np.where(np.random.default_rng(0).random((4, 200, 1)) < 0.5, -dq, dq)
    assert offsets.encode(dx, flipped, CONFIG)[0] == offsets.encode(dx, dq, CONFIG)[0]
    assert (offsets.decode(*offsets.encode(dx, -dq, CONFIG), 4, 200)[1][..., 0] > 0).all()


def test_no_motion_stays_none():
    dx = np.zeros((3, 50, 3))
    dq = rotations.normalize(np.zeros((3, 50, 4)))
    got_dx, got_dq = offsets.decode(*offsets.encode(dx, dq, CONFIG), 3, 50)
    np.testing.assert_array_equal(got_dx, dx)
    np.testing.assert_array_equal(got_dq, dq)


def test_layout_known_answers():
    """Z-order in a block of 16, every odd row of blocks from right to left."""
    pixels = h265._pixels(256 * 6, 48)
    xy = np.stack([pixels % 48, pixels // 48], -1)
    assert xy[[0, 1, 2, 3, 255]].tolist() == [[0, 0], [1, 0], [0, 1], [1, 1], [15, 15]]
    assert xy[[256, 512, 768, 1024, 1280]].tolist() == [[16, 0], [32, 0], [32, 16], [16, 16], [0, 16]]
    assert len(np.unique(pixels)) == len(pixels)


def test_is_an_mp4_that_players_take():
    dx, dq = motion(700, 5)
    data, parameters = offsets.encode(dx, dq, CONFIG)
    with av.open(io.BytesIO(data)) as container:
        streams = container.streams.video
        assert [s.metadata["handler_name"] for s in streams] == ["hi", "lo", "rot"]
        assert [s.frames for s in streams] == [5, 5, 5]
        assert {s.codec_context.profile for s in streams} == {"Main"}
        assert [s.width // parameters["width"] for s in streams] == [3, 3, 4]
        assert all(s.width % 16 == 0 and s.height % 16 == 0 for s in streams)
        keys = [p.is_keyframe for p in container.demux(streams[1]) if p.size]
        assert keys == [True] + [False] * 4
    for at in (i for i in range(len(data)) if data.startswith(b"hvcC", i)):
        assert data[at + 4 + 12] <= 150  # x265 says level 8.5 of lossless streams


def test_fold_helps_smooth_motion():
    time = np.linspace(0, 1, 6)[:, None, None]
    dx = time * np.sin(np.linspace(0, 3, 2000))[None, :, None] * np.array([1.0, 0.7, 0.5])
    dq = rotations.normalize(np.concatenate([np.ones((6, 2000, 1)), 0.1 * dx], -1))
    error = {}
    for fold in (True, False):
        got, _ = offsets.decode(*offsets.encode(dx, dq, dataclasses.replace(CONFIG, fold=fold)), 6, 2000)
        error[fold] = np.abs(got - dx).mean()
    assert error[True] < error[False]


def test_unknown_codec():
    dx, dq = motion(10, 2)
    data, parameters = offsets.encode(dx, dq, CONFIG)
    for name in ("vvc", None, [], 3):
        with pytest.raises(ReelError, match="unknown offset codec"):
            offsets.decode(data, parameters | {"codec": name}, 2, 10)


def test_nan_is_refused():
    dx, dq = motion(10, 2)
    dx[1, 3, 2] = np.nan
    with pytest.raises(ReelError, match="NaN"):
        offsets.encode(dx, dq, CONFIG)


@pytest.mark.parametrize(
    ("change", "frames", "count", "message"),
    [
        ({"width": 17}, 2, 300, "maps of 17"),
        ({"width": 8000, "height": 8000}, 2, 300, "do not fit"),
        ({"width": 1 << 40}, 2, 300, "width"),
        ({"width": 48}, 2, 300, "expected 2 pictures of"),
        ({}, 3, 300, "holds 2 pictures, expected 3"),
        ({}, 1, 300, "picture 1"),
        ({}, 2, 100_000, "do not fit"),
        ({}, 1 << 30, 300, "more than"),
        ({"fold": None}, 2, 300, "fold"),
        ({"dx_min": [0, 0, float("nan")]}, 2, 300, "dx_min"),
    ],
)
def test_lies(change, frames, count, message):
    data, parameters = offsets.encode(*motion(300, 2), CONFIG)
    with pytest.raises(ReelError, match=message):
        offsets.decode(data, parameters | change, frames, count)


def test_damaged_video():
    data, parameters = offsets.encode(*motion(300, 3), CONFIG)
    with pytest.raises(ReelError):
        offsets.decode(b"", parameters, 3, 300)
    with pytest.raises(ReelError):
        offsets.decode(data[: len(data) // 2], parameters, 3, 300)
    rng = np.random.default_rng(0)
    for _ in range(60):
        damaged = bytearray(data)
        for at in rng.integers(0, len(data), 3):
            damaged[at] ^= 1 << rng.integers(0, 8)
        with contextlib.suppress(ReelError):
            assert offsets.decode(bytes(damaged), parameters, 3, 300)[0].shape == (3, 300, 3)
