"""Gaussians as sections: what the quantisation costs, and what is refused."""

import dataclasses

import numpy as np
import pytest

from splatreel.codec.sections import Section, decode_gaussians, encode_gaussians
from splatreel.config import EncodeConfig
from splatreel.errors import GaussiansError, ReelError
from splatreel.scene.gaussians import Gaussians
from tests.codec.reels import points

CONFIG = EncodeConfig()


@pytest.mark.parametrize("count", [1, 2, 400])
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_round_trip(count, degree):
    gaussians = points(count, degree=degree)
    sections, order = encode_gaussians(gaussians, CONFIG)
    decoded, original = decode_gaussians(sections, count), gaussians[order]
    assert (len(decoded), decoded.sh_degree) == (count, degree)
    np.testing.assert_allclose(decoded.means, original.means, atol=1e-5)
    np.testing.assert_allclose(decoded.scales, original.scales, rtol=2e-3)
    np.testing.assert_allclose(decoded.opacities, original.opacities, atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(decoded.sh[:, 0], original.sh[:, 0], atol=np.ptp(original.sh[:, 0]) / 255)
    assert (np.abs((decoded.quats * original.quats).sum(1)) > 0.9995).all()
    assert (decoded.quats[:, 0] >= -1e-6).all()


def test_rest_of_few_clusters_is_nearly_exact():
    gaussians = points(400, degree=3)
    few = gaussians.sh[np.arange(400) % 7]
    sections, order = encode_gaussians(dataclasses.replace(gaussians, sh=few), CONFIG)
    np.testing.assert_allclose(decode_gaussians(sections, 400).sh, few[order], atol=0.02)


def test_no_entries_drop_the_higher_bands():
    sections, _ = encode_gaussians(points(50, degree=3), dataclasses.replace(CONFIG, sh_entries=0))
    assert decode_gaussians(sections, 50).sh_degree == 0


def test_linear_scales_are_the_papers():
    sections, _ = encode_gaussians(points(50), CONFIG, log_scales=False)
    assert "log" not in sections["scales"].parameters
    step = np.subtract(sections["scales"].parameters["max"], sections["scales"].parameters["min"]).max() / 4095
    sections_log, order = encode_gaussians(points(50), CONFIG)
    np.testing.assert_allclose(decode_gaussians(sections, 50).scales, points(50).scales[order], atol=step)
    assert sections_log["scales"].parameters["log"] is True


def test_no_points():
    sections, order = encode_gaussians(Gaussians.empty(), CONFIG)
    assert (sections, len(order), len(decode_gaussians(sections, 0))) == ({}, 0, 0)


def test_nan_is_refused():
    gaussians = points(5)
    scales = gaussians.scales.copy()
    scales[2, 1] = np.nan
    with pytest.raises(GaussiansError, match="scales"):
        encode_gaussians(dataclasses.replace(gaussians, scales=scales), CONFIG)


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("means", {"codec": "zip"}, "'means' has the unknown codec 'zip'"),
        ("means", {"bits": 99}, "'means' has bits"),
        ("quats", {"min": [0, 0, 0]}, "'quats' has min"),
        ("scales", {"min": [-400, -9, -9]}, "'scales' has logarithms"),
        ("opacities", {"max": [7]}, "opacities outside"),
        ("sh_rest", {"entries": 1}, "entries"),
        ("sh_rest", {"bits": 3}, "'sh_rest'"),
        ("sh_codebook", {"degree": 7}, "'sh_codebook' has degree"),
        ("sh_codebook", {"degree": 2}, "'sh_codebook'"),
    ],
)
def test_lies_name_the_section(name, change, message):
    sections, _ = encode_gaussians(points(100), CONFIG)
    sections[name] = Section(sections[name].data, sections[name].parameters | change)
    with pytest.raises(ReelError, match=message):
        decode_gaussians(sections, 100)


@pytest.mark.parametrize("name", ["means", "quats", "scales", "opacities", "sh_base", "sh_codebook"])
def test_missing_section(name):
    sections, _ = encode_gaussians(points(100), CONFIG)
    del sections[name]
    with pytest.raises(ReelError, match=f"no section '{name}'"):
        decode_gaussians(sections, 100)


def test_huge_count_is_refused_before_anything_is_allocated():
    sections, _ = encode_gaussians(points(100), CONFIG)
    for count in (101, 1 << 22, 1 << 40):
        with pytest.raises(ReelError):
            decode_gaussians(sections, count)
