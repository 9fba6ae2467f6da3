"""The predictive codec: the same shapes and motion come back, within what its header says."""

import dataclasses

import numpy as np
import pytest

from splatreel.codec.container import pack_file, unpack_file
from splatreel.codec.group_file import decode_group, decode_layer, encode_group, encode_layer
from splatreel.codec.predictive import coder, covariance, klt, quantized_positions, rotvec
from splatreel.codec.predictive.entropy import encode
from splatreel.config import EncodeConfig
from splatreel.errors import ReelError
from splatreel.scene import rotations
from splatreel.scene.group import Group
from tests.golden import random_gaussians, random_motion, random_shade

CONFIG = EncodeConfig(codec="predictive")


def points(count=300, degree=2, seed=0):
    return random_gaussians(np.random.default_rng(seed), count, degree, (0, 0, 0))


def group(count=300, frames=12):
    moving = points(count)
    dx, dq = random_motion(np.random.default_rng(1), moving, frames)
    return Group(0, 0, moving, dx, dq, np.zeros(0, bool))


def covariances(gaussians):
    axes = rotations.to_matrix(gaussians.quats.astype(np.float64)) * gaussians.scales[:, None]
    return axes @ axes.transpose(0, 2, 1)


def test_rotation_vectors_go_on_where_quaternions_turn_round():
    angle = np.linspace(0, 9, 40)[:, None, None]
    quats = np.concatenate([np.cos(angle / 2), np.sin(angle / 2) * [0, 0.6, 0.8]], -1)
    signs = np.where(np.arange(40) % 3 > 0, 1, -1)[:, None, None]
    np.testing.assert_allclose(rotvec.of_quats(quats * signs), angle * [0, 0.6, 0.8], atol=1e-9)
    np.testing.assert_allclose(rotvec.to_quats(angle * [0, 0.6, 0.8]), quats, atol=1e-9)


def test_klt_keeps_what_few_directions_hold():
    rng = np.random.default_rng(0)
    samples = rng.normal(size=(500, 3)) @ rng.normal(size=(3, 30))
    basis, shifts = klt.analyse(samples, 0.01)
    assert basis.shape == (30, 3)
    back = klt.coefficients(samples, basis, shifts) @ klt.real(basis, shifts).T
    assert np.abs(back - samples).max() < 0.02
    np.testing.assert_array_equal(
        klt.decode_basis(klt.encode_basis(basis), {"shifts": shifts}, "shifts", 30), klt.real(basis, shifts)
    )


def test_columns_that_are_small_come_last():
    found = np.ones((5, 4, 2)) * np.array([8.0, 4, 1, 2])[:, None]
    found[..., 1] /= 100
    order = klt.columns_of(found)
    assert (order % 2).tolist() == [0, 0, 0, 0, 1, 1, 1, 1]
    assert (order // 2).tolist() == [0, 1, 2, 3, 0, 1, 2, 3], "those of a channel in the order of the basis"
    data = encode(order % 2, np.zeros(8, np.int64), 1)
    np.testing.assert_array_equal(klt.decode_columns(data, 8, 4, 2), order % 2)
    for kinds, channels in ((3, 2), (4, 1)):
        with pytest.raises(ReelError, match="has columns"):
            klt.decode_columns(data, 8, kinds, channels)


def test_a_sum_takes_each_column_to_its_vector_and_channel():
    basis = np.array([[1.0, 10.0], [2.0, 20.0]])  # two dimensions, two vectors
    found, columns = np.array([[1, 2, 3]], np.int32), np.array([0, 1, 0])
    whole = klt.expand(found, np.array([3]), basis, columns, 2)
    np.testing.assert_array_equal(whole[:, 0], [[1 + 30, 2], [2 + 60, 4]])
    part = klt.expand(found, np.array([2]), basis, columns, 2)
    np.testing.assert_array_equal(part[:, 0], [[1, 2], [2, 4]])


@pytest.mark.parametrize("count", [1, 2, 500])
@pytest.mark.parametrize("offset", [0.0, 1000.0])
def test_positions(count, offset):
    means = np.random.default_rng(count).normal(size=(count, 3)) + offset
    data, parameters, order, found = quantized_positions.encode_positions(means, 0.004)
    np.testing.assert_array_equal(quantized_positions.decode_positions(data, parameters, count), found)
    bits = np.arange(count) % 4
    places = quantized_positions.encode_places(means[order], parameters, found, bits)
    decoded = quantized_positions.decode_places(places, parameters, found, bits)
    assert (np.abs(decoded - means[order]) <= 0.00201 * 0.5 ** bits[:, None] + 1e-7 * offset).all()
    assert len(places) == (3 * bits.sum() + 7) // 8


def test_points_that_coincide_and_a_scene_too_large_for_the_step():
    means = np.concatenate([np.zeros((5, 3)), np.full((1, 3), 1e6)])
    data, parameters, order, _ = quantized_positions.encode_positions(means, 1e-3)
    found, bits = quantized_positions.decode_positions(data, parameters, 6), np.zeros(6, np.int64)
    decoded = quantized_positions.decode_places(b"", parameters, found, bits)
    np.testing.assert_allclose(decoded, means[order], atol=parameters["step"])


def test_points_come_back():
    before = points()
    data, order = encode_layer(0, 0, before, CONFIG)
    after = decode_layer(data, "a layer")[1]
    size = np.exp(np.median(np.log(before.scales)))
    steps = coder.STEPS
    before = before[order]
    assert np.abs(after.means - before.means).max() <= 0.51 * steps.position * size
    shapes = [covariance.of_shapes(g.quats, g.scales) for g in (after, before)]
    np.testing.assert_allclose(*shapes, atol=0.61 * steps.shape)
    assert np.abs(after.opacities - before.opacities).max() <= 0.61 * steps.opacity
    assert np.abs(after.sh[:, 0] - before.sh[:, 0]).max() <= 1.1 * steps.color
    assert np.sqrt(((after.sh[:, 1:] - before.sh[:, 1:]) ** 2).mean()) <= steps.rest
    worst = np.abs(covariances(after) - covariances(before)).max((1, 2)) / before.scales.max(1) ** 2
    assert worst.max() < 0.2


def test_motion_is_as_near_as_the_header_says():
    before = group()
    data, order = encode_group(before, CONFIG)
    after = decode_group(data, "a group")
    sections = unpack_file(data)[1]
    assert np.abs(after.dx - before.dx[:, order]).max() <= sections["dx"].parameters["error"] + 1e-6
    steps, size = coder.STEPS, np.exp(np.median(np.log(before.dynamic.scales)))
    assert sections["dx"].parameters["error"] < 4 * steps.motion * size
    # Rotations of the moved points, whichever of the 24 ways they are written in.
    for frame in range(before.frames):
        moved = [covariances(g.at(frame)) for g in (after, before)]
        largest = before.dynamic.scales[order].max(1) ** 2
        assert (np.abs(moved[0] - moved[1][order]).max((1, 2)) / largest).max() < 0.25


def test_between_frames_a_point_is_on_its_decoded_curve():
    after = decode_group(encode_group(group(), CONFIG)[0], "a group")
    middle = after.at(3.25).means - after.dynamic.means
    np.testing.assert_allclose(middle, 0.75 * after.dx[3] + 0.25 * after.dx[4], atol=1e-6)


def test_coarser_is_smaller_and_importance_saves():
    whole = len(encode_group(group(), CONFIG)[0])
    coarse = len(encode_group(group(), dataclasses.replace(CONFIG, coarseness=4.0))[0])
    importance = np.full((300, 3), 1e-3)
    importance[:60] = 1.0
    unequal = len(encode_group(group(), CONFIG, importance=importance)[0])
    assert coarse < 0.8 * whole
    assert unequal < 0.85 * whole


def test_where_all_steps_are_coarse_those_of_hidden_points_grow_less():
    importance = np.geomspace(1, 1e-5, 60)[:, None].repeat(3, 1)
    fine, coarse = (coder.classes_of(importance, 60, coarseness) for coarseness in (0.6, 2.5))
    assert (fine.max(), coarse.max()) == (3, 2)
    assert (coarse == np.minimum(fine, 2)).all()


def test_important_points_keep_their_precision():
    importance = np.full((300, 3), 1e-3)
    importance[:60] = 1.0
    data, order = encode_layer(0, 0, points(), CONFIG, importance=importance)
    error = np.abs(decode_layer(data, "a layer")[1].sh[:, 0] - points().sh[order, 0]).max(1)
    assert error[order < 60].max() <= 1.1 * coder.STEPS.color < error.max()


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
def test_lies(section, change, message):
    header, sections = unpack_file(encode_group(group(40, 3), CONFIG)[0])
    found = sections[section]
    if "nan" not in str(change):
        sections[section] = dataclasses.replace(found, parameters=found.parameters | change)
        with pytest.raises(ReelError, match=message):
            decode_group(pack_file(header, sections), "here")


@pytest.mark.parametrize("codec", ["predictive", "h265"])
def test_colours_and_opacities_that_change_come_back(codec):
    before = dataclasses.replace(group(), shade=random_shade(np.random.default_rng(2), 300, 12))
    data, order = encode_group(before, EncodeConfig(codec=codec), None)
    after = decode_group(data, "x")
    step = coder.STEPS.shade * CONFIG.coarseness
    np.testing.assert_allclose(after.shade, before.shade[:, order], atol=step)
    assert not np.allclose(after.at(3).opacities, after.at(0).opacities, atol=0.05)


def test_a_shade_of_another_size_is_refused():
    data, _ = encode_group(dataclasses.replace(group(), shade=random_shade(np.random.default_rng(2), 300, 12)), CONFIG)
    header, sections = unpack_file(data)
    sections["shade"] = dataclasses.replace(sections["shade"], data=sections["shade"].data[:-3])
    with pytest.raises(ReelError, match="'shade'"):
        decode_group(pack_file(header, sections), "x")
