"""Gaussians as sections: quantization error and refused input."""

import dataclasses

import numpy as np
import pytest

from splatreel.base.errors import GaussiansError, ReelError
from splatreel.codec.paper.gaussians import decode_gaussians, encode_gaussians
from splatreel.codec.section import Section
from splatreel.config import EncodeConfig
from splatreel.scene.gaussians import Gaussians
from tests.codec.reels import points

CONFIG = EncodeConfig()


@pytest.mark.parametrize("count", [1, 2, 400])
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_paper_gaussians_round_trip(count, degree):
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


def test_codebook_of_few_clusters_is_nearly_exact():
    gaussians = points(400, degree=3)
    few = gaussians.sh[np.arange(400) % 7]
    sections, order = encode_gaussians(dataclasses.replace(gaussians, sh=few), CONFIG)
    np.testing.assert_allclose(decode_gaussians(sections, 400).sh, few[order], atol=0.02)


def test_zero_entries_drop_higher_bands():
    sections, _ = encode_gaussians(points(50, degree=3), dataclasses.replace(CONFIG, sh_entries=0))
    assert decode_gaussians(sections, 50).sh_degree == 0


def test_linear_scales_are_the_papers():
    sections, _ = encode_gaussians(points(50), CONFIG.with_h265(log_scales=False))
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
def test_invalid_sections_are_named(name, change, message):
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


FLOATS = dict.fromkeys(("position_bits", "quat_bits", "opacity_bits", "scale_bits", "color_bits"))


def test_float32_coding_is_lossless():
    """Dashes in the paper's Table 9 mean float32, in the order of the reel."""
    gaussians = points(300, degree=3)
    sections, order = encode_gaussians(gaussians, dataclasses.replace(CONFIG.with_h265(**FLOATS), sh_entries=None))
    decoded, original = decode_gaussians(sections, 300), gaussians[order]
    for name in ("means", "scales", "opacities", "sh"):
        np.testing.assert_array_equal(getattr(decoded, name), getattr(original, name))
    np.testing.assert_allclose(np.abs((decoded.quats * original.quats).sum(1)), 1, atol=1e-6)
    assert sum(len(s.data) for s in sections.values()) == 4 * 59 * 300


def test_sh_rest_without_quantization_or_codebook():
    gaussians = points(300, degree=2)
    sections, order = encode_gaussians(
        gaussians, dataclasses.replace(CONFIG.with_h265(color_bits=None), sh_entries=5000)
    )
    assert (len(sections["sh_codebook"].data), sections["sh_rest"].parameters["entries"]) == (4 * 24 * 75, 75)
    np.testing.assert_array_equal(decode_gaussians(sections, 300).sh[:, 0], gaussians.sh[order, 0])
    sections, order = encode_gaussians(gaussians, dataclasses.replace(CONFIG, sh_entries=None))
    step = np.ptp(gaussians.sh[:, 1:], axis=0).max() / 255
    np.testing.assert_allclose(decode_gaussians(sections, 300).sh, gaussians.sh[order], atol=10 * step)


def test_attributes_as_images_round_trip():
    """With 8 bits of video, as V3: errors are a few steps, and a higher CRF is coarser and smaller."""
    gaussians = points(500, degree=1)
    sizes, errors = [], []
    for crf in (0, 40):
        sections, order = encode_gaussians(gaussians, CONFIG.with_h265(crf_attributes=crf))
        decoded = decode_gaussians(sections, 500)
        assert {sections[n].parameters["codec"] for n in ("scales", "opacities", "sh_base", "sh_rest")} == {"picture"}
        sizes.append(sum(len(s.data) for s in sections.values()))
        errors.append(np.abs(decoded.sh - gaussians.sh[order]).mean())
        assert ((decoded.opacities >= 0) & (decoded.opacities <= 1)).all()
    assert sizes[1] < sizes[0]
    assert errors[0] < 0.02 < errors[1]


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("means", {"codec": "float32"}, "section 'means' holds .* bytes where float32"),
        ("sh_rest", {"codec": "float32"}, "section 'sh_rest' has degree"),
        ("sh_rest", {"codec": "float32", "degree": 1}, "section 'sh_rest' holds"),
        ("scales", {"codec": "picture"}, "section 'scales' has width"),
        ("scales", {"codec": "picture", "width": 64, "height": 64}, "section 'scales' is not made of whole MP4 boxes"),
    ],
)
def test_unknown_codecs_are_refused(name, change, message):
    sections, _ = encode_gaussians(points(100), CONFIG)
    sections[name] = Section(sections[name].data, sections[name].parameters | change)
    with pytest.raises(ReelError, match=message):
        decode_gaussians(sections, 100)


def test_float32_nan_is_refused():
    sections, _ = encode_gaussians(points(100), CONFIG.with_h265(scale_bits=None))
    sections["scales"] = Section(np.full(300, np.nan, "<f4").tobytes(), sections["scales"].parameters)
    with pytest.raises(ReelError, match="section 'scales' holds NaN"):
        decode_gaussians(sections, 100)


def test_weighted_codebook_favors_important_points():
    gaussians = points(400, degree=3)
    weights = np.where(np.arange(400) < 100, 100.0, 0.0)
    plain = dataclasses.replace(CONFIG.with_h265(weighted_codebook=False), sh_entries=30)
    first, _ = encode_gaussians(gaussians, plain)
    second, _ = encode_gaussians(gaussians, plain, weights=weights)
    assert first["sh_rest"] == second["sh_rest"]
    errors = []
    for given in (None, weights):
        sections, order = encode_gaussians(gaussians, plain.with_h265(weighted_codebook=True), weights=given)
        error = np.abs(decode_gaussians(sections, 400).sh - gaussians.sh[order])[:, 1:].mean((1, 2))
        errors.append(error[order < 100].mean())
    assert errors[1] < 0.9 * errors[0]
