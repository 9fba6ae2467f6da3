"""Points and motion round trip within the header's error; invalid headers are refused."""

import dataclasses

import numpy as np
import pytest

from splatreel.base.errors import ReelError
from splatreel.codec.container import pack_file, unpack_file
from splatreel.codec.group_file import decode_group, decode_layer, encode_group, encode_layer
from splatreel.codec.predictive import covariance
from splatreel.codec.predictive.precision import STEPS
from splatreel.scene import rotations
from tests.codec.predictive.groups import CONFIG, group, points


def covariances(gaussians):
    axes = rotations.to_matrix(gaussians.quats.astype(np.float64)) * gaussians.scales[:, None]
    return axes @ axes.transpose(0, 2, 1)


def test_predictive_points_round_trip():
    before = points()
    data, order = encode_layer(0, 0, before, CONFIG)
    after = decode_layer(data, "a layer")[1]
    size = np.exp(np.median(np.log(before.scales)))
    steps = STEPS
    before = before[order]
    assert np.abs(after.means - before.means).max() <= 0.51 * steps.position * size
    found, expected = (covariance.of_shapes(g.quats, g.scales) for g in (after, before))
    np.testing.assert_allclose(found, expected, atol=0.61 * steps.shape)
    assert np.abs(after.opacities - before.opacities).max() <= 0.61 * steps.opacity
    assert np.abs(after.sh[:, 0] - before.sh[:, 0]).max() <= 1.1 * steps.color
    assert np.sqrt(((after.sh[:, 1:] - before.sh[:, 1:]) ** 2).mean()) <= steps.rest
    worst = np.abs(covariances(after) - covariances(before)).max((1, 2)) / before.scales.max(1) ** 2
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
        moved = [covariances(g.at(frame)) for g in (after, before)]
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
