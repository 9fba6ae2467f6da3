"""Offset codecs: precision, layout, determinism, damage."""

import contextlib
import io

import av
import numpy as np
import pytest

from splatreel.base.errors import ReelError
from splatreel.codec.container import pack_file, unpack_file
from splatreel.codec.group_file import decode_group, encode_group
from splatreel.codec.paper import hevc, offsets
from splatreel.config import EncodeConfig
from splatreel.scene import rotations
from splatreel.scene.group import Group
from tests.golden import random_gaussians, random_motion

CONFIG = EncodeConfig(codec="h265")


def motion(count, frames, seed=0):
    rng = np.random.default_rng(seed)
    return random_motion(rng, random_gaussians(rng, count, 0, (0, 0, 0)), frames)


def encode(dx, dq, config=CONFIG):
    """Encode motion of points that `ofs` ignores."""
    return offsets.encode(dx, dq, random_gaussians(np.random.default_rng(0), dx.shape[1], 0, (0, 0, 0)), config.h265)


def angles(a, b):
    """Return the angles in degrees between rotations."""
    return np.degrees(2 * np.arccos(np.clip(np.abs((a * b).sum(-1)), 0, 1)))


@pytest.mark.parametrize(("count", "frames"), [(1, 1), (1, 5), (300, 1), (700, 8)])
@pytest.mark.parametrize("fold", [True, False])
def test_paper_offsets_round_trip(count, frames, fold):
    dx, dq = motion(count, frames)
    data, parameters = encode(dx, dq, CONFIG.with_h265(fold=fold))
    got_dx, got_dq = offsets.decode(data, parameters, frames, count)
    assert (got_dx.dtype, got_dq.dtype) == (np.float32, np.float32)
    extent = np.ptp(dx, axis=(0, 1)).max()
    assert np.abs(got_dx - dx).max() <= 256 / 65535 * extent + 1e-6  # the high byte is lossless
    assert np.sqrt(((got_dx - dx) ** 2).mean()) < 5e-4 * extent + 1e-6
    assert angles(got_dq, dq).mean() < 2
    np.testing.assert_allclose(np.linalg.norm(got_dq, axis=-1), 1, atol=1e-5)


def test_offset_bytes_are_reproducible():
    dx, dq = motion(300, 4)
    assert encode(dx, dq) == encode(dx, dq)


def test_quaternion_signs_do_not_matter():
    dx, dq = motion(200, 4)
    flipped = np.where(np.random.default_rng(0).random((4, 200, 1)) < 0.5, -dq, dq)
    assert encode(dx, flipped)[0] == encode(dx, dq)[0]
    assert (offsets.decode(*encode(dx, -dq), 4, 200)[1][..., 0] > 0).all()


def test_zero_motion_is_exact():
    dx = np.zeros((3, 50, 3))
    dq = rotations.normalize(np.zeros((3, 50, 4)))
    got_dx, got_dq = offsets.decode(*encode(dx, dq), 3, 50)
    np.testing.assert_array_equal(got_dx, dx)
    np.testing.assert_array_equal(got_dq, dq)


def test_map_layout_known_answers():
    """Z-order in a block of 16, every odd row of blocks from right to left."""
    pixels = hevc.pixels_of(256 * 6, 48)
    xy = np.stack([pixels % 48, pixels // 48], -1)
    assert xy[[0, 1, 2, 3, 255]].tolist() == [[0, 0], [1, 0], [0, 1], [1, 1], [15, 15]]
    assert xy[[256, 512, 768, 1024, 1280]].tolist() == [[16, 0], [32, 0], [32, 16], [16, 16], [0, 16]]
    assert len(np.unique(pixels)) == len(pixels)


def test_offsets_are_a_playable_mp4():
    dx, dq = motion(700, 5)
    data, parameters = encode(dx, dq)
    with av.open(io.BytesIO(data)) as container:
        streams = container.streams.video
        assert [s.metadata["handler_name"] for s in streams] == ["hi", "lo", "rot"]
        assert [s.frames for s in streams] == [5, 5, 5]
        assert {s.codec_context.profile for s in streams} == {"Main"}
        assert [s.width // parameters["width"] for s in streams] == [3, 3, 4]
        assert all(s.width % 16 == 0 and s.height % 16 == 0 for s in streams)
        keys = [p.is_keyframe for p in container.demux(streams[1]) if p.size]  # pyright: ignore[reportAttributeAccessIssue]
        assert keys == [True] + [False] * 4
    for at in (i for i in range(len(data)) if data.startswith(b"hvcC", i)):
        assert data[at + 4 + 12] <= 150  # x265 says level 8.5 of lossless streams


def test_fold_helps_smooth_motion():
    time = np.linspace(0, 1, 6)[:, None, None]
    dx = time * np.sin(np.linspace(0, 3, 2000))[None, :, None] * np.array([1.0, 0.7, 0.5])
    dq = rotations.normalize(np.concatenate([np.ones((6, 2000, 1)), 0.1 * dx], -1))
    error = {}
    for fold in (True, False):
        got, _ = offsets.decode(*encode(dx, dq, CONFIG.with_h265(fold=fold)), 6, 2000)
        error[fold] = np.abs(got - dx).mean()
    assert error[True] < error[False]


def test_unknown_offset_codec_is_refused():
    dx, dq = motion(10, 2)
    data, parameters = encode(dx, dq)
    for name in ("vvc", None, [], 3):
        with pytest.raises(ReelError, match="unknown offset codec"):
            offsets.decode(data, parameters | {"codec": name}, 2, 10)


def test_nan_is_refused():
    dx, dq = motion(10, 2)
    dx[1, 3, 2] = np.nan
    with pytest.raises(ReelError, match="NaN"):
        encode(dx, dq)


@pytest.mark.parametrize(
    ("change", "frames", "count", "message"),
    [
        ({"width": 17}, 2, 300, "maps of 17"),
        ({"width": 8000, "height": 8000}, 2, 300, "do not fit"),
        ({"width": 1 << 40}, 2, 300, "width"),
        ({"width": 48}, 2, 300, "expected 2 images of"),
        ({}, 3, 300, "holds 2 images, expected 3"),
        ({}, 1, 300, "claims 2 samples, at most 1"),
        ({}, 2, 100_000, "do not fit"),
        ({}, 1 << 30, 300, "more than"),
        ({"fold": None}, 2, 300, "fold"),
        ({"dx_min": [0, 0, float("nan")]}, 2, 300, "dx_min"),
    ],
)
def test_invalid_offset_parameters_are_refused(change, frames, count, message):
    data, parameters = encode(*motion(300, 2))
    with pytest.raises(ReelError, match=message):
        offsets.decode(data, parameters | change, frames, count)


def test_damaged_video_is_refused():
    data, parameters = encode(*motion(300, 3))
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


@pytest.mark.parametrize(
    ("source", "tolerance", "degrees"),
    [("ofs", 0.003, 0.5), ("ori", 0.006, 1.5), ("dif", 0.02, 1.5), ("raw", 1e-6, 0.1)],
)
def test_all_sources_of_table_10_round_trip(source, tolerance, degrees):
    """Files of all sources decode to the same dynamic points with different precision."""
    rng = np.random.default_rng(3)
    points = random_gaussians(rng, 400, 1, (2, 0, 0))
    dx, dq = random_motion(rng, points, 6)
    group = Group(0, 0, points, dx, dq, np.zeros(0, bool))
    data, order = encode_group(group, CONFIG.with_h265(source=source, crf=4, quat_bits=16))
    decoded = decode_group(data, "it")
    for frame in range(6):
        expected, found = group.at(frame)[order], decoded.at(frame)
        np.testing.assert_allclose(found.means, expected.means, atol=tolerance * np.ptp(expected.means))
        assert np.median(angles(found.quats, expected.quats)) < degrees


def test_original_source_stores_the_first_frame_once():
    rng = np.random.default_rng(3)
    points = random_gaussians(rng, 200, 0, (0, 0, 0))
    group = Group(0, 0, points, *random_motion(rng, points, 3), np.zeros(0, bool))
    data, _ = encode_group(group, CONFIG.with_h265(source="ori"))
    header, sections = unpack_file(data)
    assert not {"means", "quats"} & set(sections)
    assert sections["offsets"].parameters["codec"] == "h265-ori"
    np.testing.assert_array_equal(decode_group(data, "it").dx[0], 0)
    del sections["offsets"]
    with pytest.raises(ReelError, match="it: has no section 'means'"):
        decode_group(pack_file(header, sections), "it")


def test_truncated_raw_offsets_are_refused():
    data, parameters = encode(*motion(30, 2), CONFIG.with_h265(source="raw"))
    assert len(data) == 4 * 7 * 2 * 30
    with pytest.raises(ReelError, match="float32 numbers of shape"):
        offsets.decode(data[:-4], parameters, 2, 30)
