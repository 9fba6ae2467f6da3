"""Points and motion round trip within the header's error; invalid headers are refused."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from splatreel.base.errors import ReelError
from splatreel.codec.container import pack_file, unpack_file
from splatreel.codec.group_file import decode_group, decode_layer, encode_group, encode_layer
from splatreel.codec.predictive.points import (
    LARGEST_OCTAVE,
    decode_quantized_positions,
    decode_refinement_bits,
    encode_quantized_positions,
    encode_refinement_bits,
    rotation_vectors,
    shape_numbers,
    shapes_of_numbers,
)
from splatreel.codec.predictive.precision import STEPS
from splatreel.config import EncodeConfig
from splatreel.scene import rotations
from tests.codec.predictive.groups import CONFIG, group, points
from tests.golden import random_shade


def covariances(quats, scales):
    axes = rotations.to_matrix(quats.astype(np.float64)) * scales[:, None]
    return axes @ axes.transpose(0, 2, 1)


def test_predictive_points_round_trip():
    before = points()
    data, order = encode_layer(0, 0, before, CONFIG)
    after = decode_layer(data, "a layer")[1]
    size = np.exp(np.median(np.log(before.scales)))
    steps = STEPS
    before = before[order]
    assert np.abs(after.means - before.means).max() <= 0.51 * steps.position * size
    found, expected = (shape_numbers(g.quats, g.scales) for g in (after, before))
    np.testing.assert_allclose(found, expected, atol=0.61 * steps.shape)
    assert np.abs(after.opacities - before.opacities).max() <= 0.61 * steps.opacity
    assert np.abs(after.sh[:, 0] - before.sh[:, 0]).max() <= 1.1 * steps.color
    assert np.sqrt(((after.sh[:, 1:] - before.sh[:, 1:]) ** 2).mean()) <= steps.rest
    worst = (
        np.abs(covariances(after.quats, after.scales) - covariances(before.quats, before.scales)).max((1, 2))
        / before.scales.max(1) ** 2
    )
    assert worst.max() < 0.2


def test_offset_error_matches_the_header():
    before = group()
    data, order = encode_group(before, CONFIG)
    after = decode_group(data, "a group")
    sections = unpack_file(data)[1]
    assert np.abs(after.dx - before.dx[:, order]).max() <= sections["dx"].parameters["error"] + 1e-6
    steps, size = STEPS, np.exp(np.median(np.log(before.dynamic.scales)))
    assert sections["dx"].parameters["error"] < 4 * steps.motion * size
    # Rotations of the moved points, whichever of the 24 ways they are written in.
    for frame in range(before.frames):
        moved = [covariances(now.quats, now.scales) for now in (after.at(frame), before.at(frame))]
        largest = before.dynamic.scales[order].max(1) ** 2
        assert (np.abs(moved[0] - moved[1][order]).max((1, 2)) / largest).max() < 0.25


def test_decoded_offsets_interpolate_between_frames():
    after = decode_group(encode_group(group(), CONFIG)[0], "a group")
    middle = after.at(3.25).means - after.dynamic.means
    np.testing.assert_allclose(middle, 0.75 * after.dx[3] + 0.25 * after.dx[4], atol=1e-6)


@pytest.mark.parametrize(
    ("section", "change", "message"),
    [
        ("means", {"step": -1.0}, "'means' has step"),
        ("means", {"min": [0.0]}, "'means' has min"),
        ("means", {"finer": 8}, "'means' has finer"),
        ("means", {"finer": 2}, "'places' holds"),
        ("places", {"codec": "bits"}, "'places' has the unknown codec"),
        ("shapes", {"step": float("nan")}, "'shapes' has step"),
        ("shapes", {"codec": "linear"}, "'shapes' has the unknown codec"),
        ("dx", {"shifts": []}, "'dx' has shifts"),
        ("dx", {"shifts": [99]}, "'dx' has shifts"),
        ("dx", {"columns": 0}, "'dx' has columns"),
        ("dx", {"columns": 1}, "'dx'"),
        ("dq", {"step": None}, "'dq' has step"),
        ("sh_rest", {"degree": 7}, "'sh_rest' has degree"),
    ],
)
def test_invalid_predictive_sections_are_refused(section, change, message):
    header, sections = unpack_file(encode_group(group(40, 3), CONFIG)[0])
    found = sections[section]
    if "nan" not in str(change):
        sections[section] = dataclasses.replace(found, parameters=found.parameters | change)
        with pytest.raises(ReelError, match=message):
            decode_group(pack_file(header, sections), "here")


def random_shapes(count, spread, seed=0):
    rng = np.random.default_rng(seed)
    return rotations.normalize(rng.normal(size=(count, 4))), np.exp2(rng.normal(size=(count, 3)) * spread)


@pytest.mark.parametrize("spread", [0.0, 1e-7, 0.3, 4.0])
def test_shapes_round_trip(spread):
    quats, scales = random_shapes(500, spread)
    scales[:100, 1] = scales[:100, 0]  # round about an axis
    quats[100:150] = [1, 0, 0, 0]
    found = shapes_of_numbers(shape_numbers(quats, scales))
    wanted = covariances(quats, scales)
    off = np.abs(covariances(*found) - wanted).max((1, 2)) / np.abs(wanted).max((1, 2))
    assert off.max() < 1e-7
    np.testing.assert_allclose(np.linalg.norm(found[0], axis=1), 1, atol=1e-12)


def test_shapes_do_not_depend_on_axis_order_or_sign():
    quats, scales = random_shapes(50, 1.0)
    exchanged = rotations.normalize(rotations.multiply(quats, np.array([1.0, 1.0, 1.0, 1.0])))  # x, y, z to y, z, x
    np.testing.assert_allclose(
        shape_numbers(-exchanged, scales[:, [1, 2, 0]]), shape_numbers(quats, scales), atol=1e-12
    )


def test_shape_numbers_known_answers():
    """Doubling all scales adds one octave per direction, which only the first number contains."""
    still = np.array([[1.0, 0, 0, 0]])
    np.testing.assert_allclose(
        shape_numbers(still, np.full((1, 3), 2.0)), [[3 * np.sqrt(2 / 3), 0, 0, 0, 0, 0]], atol=1e-12
    )
    np.testing.assert_allclose(
        shape_numbers(still, np.array([[4.0, 1, 1]])),
        [[2 * np.sqrt(2 / 3), np.sqrt(2), -2 / np.sqrt(6), 0, 0, 0]],
        atol=1e-12,
    )
    eighth = np.array([[np.cos(np.pi / 8), 0, 0, np.sin(np.pi / 8)]])  # 45 degrees about z
    np.testing.assert_allclose(shape_numbers(eighth, np.array([[2.0, 0.5, 1]]))[0, 3:], [np.sqrt(2), 0, 0], atol=1e-12)


@given(arrays(np.float64, (3, 6), elements=st.floats(-1e12, 1e12)))
def test_any_numbers_decode_to_a_shape(numbers):
    quats, scales = shapes_of_numbers(numbers)
    assert np.isfinite(quats).all()
    assert (scales >= 2.0**-LARGEST_OCTAVE).all()
    assert (scales <= 2.0**LARGEST_OCTAVE).all()
    np.testing.assert_allclose(np.linalg.norm(quats, axis=1), 1, atol=1e-9)


@pytest.mark.parametrize("count", [1, 2, 500])
@pytest.mark.parametrize("offset", [0.0, 1000.0])
def test_quantized_positions_round_trip(count, offset):
    means = np.random.default_rng(count).normal(size=(count, 3)) + offset
    data, parameters, order, found = encode_quantized_positions(means, 0.004)
    np.testing.assert_array_equal(decode_quantized_positions(data, parameters, count), found)
    bits = np.arange(count) % 4
    refinement = encode_refinement_bits(means[order], parameters, found, bits)
    decoded = decode_refinement_bits(refinement, parameters, found, bits)
    assert (np.abs(decoded - means[order]) <= 0.00201 * 0.5 ** bits[:, None] + 1e-7 * offset).all()
    assert len(refinement) == (3 * bits.sum() + 7) // 8


def test_coinciding_points_and_large_scenes_round_trip():
    means = np.concatenate([np.zeros((5, 3)), np.full((1, 3), 1e6)])
    data, parameters, order, _ = encode_quantized_positions(means, 1e-3)
    found, bits = decode_quantized_positions(data, parameters, 6), np.zeros(6, np.int64)
    decoded = decode_refinement_bits(b"", parameters, found, bits)
    np.testing.assert_allclose(decoded, means[order], atol=parameters["step"])


def test_rotation_vectors_are_continuous_over_time():
    angle = np.linspace(0, 9, 40)[:, None, None]
    quats = np.concatenate([np.cos(angle / 2), np.sin(angle / 2) * [0, 0.6, 0.8]], -1)
    signs = np.where(np.arange(40) % 3 > 0, 1, -1)[:, None, None]
    np.testing.assert_allclose(rotation_vectors(quats * signs), angle * [0, 0.6, 0.8], atol=1e-9)


@pytest.mark.parametrize("codec", ["predictive", "h265"])
def test_shade_round_trips(codec):
    before = dataclasses.replace(group(), shade=random_shade(np.random.default_rng(2), 300, 12))
    data, order = encode_group(before, EncodeConfig(codec=codec), None)
    after = decode_group(data, "x")
    step = STEPS.shade * CONFIG.coarseness
    assert after.shade is not None
    np.testing.assert_allclose(after.shade, before.shade[:, order], atol=step)
    assert not np.allclose(after.at(3).opacities, after.at(0).opacities, atol=0.05)


def test_shade_of_wrong_size_is_refused():
    data, _ = encode_group(dataclasses.replace(group(), shade=random_shade(np.random.default_rng(2), 300, 12)), CONFIG)
    header, sections = unpack_file(data)
    sections["shade"] = dataclasses.replace(sections["shade"], data=sections["shade"].data[:-3])
    with pytest.raises(ReelError, match="'shade'"):
        decode_group(pack_file(header, sections), "x")
