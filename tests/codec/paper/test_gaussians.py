"""Gaussians as sections: quantization error and refused input."""

import contextlib
import dataclasses
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatreel.base.errors import GaussiansError, MissingDependencyError, ReelError
from splatreel.codec.container import Section
from splatreel.codec.paper.gaussians import (
    assign,
    decode_draco,
    decode_gaussians,
    encode_draco,
    encode_gaussians,
    kmeans,
)
from splatreel.config import EncodeConfig
from splatreel.play.timeline import open_reel
from splatreel.scene import morton
from splatreel.scene.gaussians import Gaussians
from tests.codec.reels import points
from tests.golden import GOLDEN, PREDICTIVE

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
    for some in (None, weights):
        sections, order = encode_gaussians(gaussians, plain.with_h265(weighted_codebook=True), weights=some)
        error = np.abs(decode_gaussians(sections, 400).sh - gaussians.sh[order])[:, 1:].mean((1, 2))
        errors.append(error[order < 100].mean())
    assert errors[1] < 0.9 * errors[0]


@pytest.mark.parametrize("count", [1, 2, 3, 1000])
@pytest.mark.parametrize("offset", [0.0, 1000.0])
def test_draco_round_trip_and_order(count, offset):
    means = np.random.default_rng(count).normal(size=(count, 3)).astype(np.float32) + np.float32(offset)
    data, parameters, order = encode_draco(means, 20)
    decoded = decode_draco(data, parameters, count)
    assert decoded.dtype == np.float32
    assert sorted(order) == list(range(count))
    step = parameters["range"] / ((1 << 20) - 1)
    np.testing.assert_allclose(decoded, means[order], atol=0.51 * step + offset * 1e-7)
    q = np.rint((decoded.astype(np.float64) - parameters["min"]) / step)
    if not offset:
        assert (np.diff(morton.encode(q.astype(np.int64)).astype(np.int64)) > 0).all()


def test_draco_bytes_do_not_depend_on_order():
    means = np.random.default_rng(0).random((500, 3))
    data, _, order = encode_draco(means, 20)
    assert encode_draco(means, 20)[0] == data
    assert encode_draco(means[::-1], 20)[0] == data
    assert encode_draco(means[order], 20)[0] == data


def test_draco_takes_six_bytes_per_point():
    means = np.random.default_rng(0).random((20_000, 3))
    assert len(encode_draco(means, 20)[0]) < 6.5 * len(means)


@settings(max_examples=20, deadline=None)
@given(st.integers(2, 300), st.integers(1, 40), st.integers(0, 2**32 - 1))
def test_coinciding_points_are_kept(count, places, seed):
    """Clones share their positions. None may be lost, and all stay within a few grid cells."""
    rng = np.random.default_rng(seed)
    means = rng.normal(size=(places, 3))[rng.integers(0, places, count)]
    data, parameters, order = encode_draco(means, 20)
    decoded = decode_draco(data, parameters, count)
    assert len(np.unique(decoded, axis=0)) == count or parameters["range"] == 1.0
    np.testing.assert_allclose(decoded, means[order], atol=20 * parameters["range"] / (1 << 20) + 1e-6)


def test_too_many_points_are_refused():
    with pytest.raises(ReelError, match="position bits"):
        encode_draco(np.random.default_rng(0).random((5000, 3)), 4)


@pytest.mark.parametrize("bits", [3, 22])
def test_invalid_bits_are_refused(bits):
    with pytest.raises(ReelError, match="bits"):
        encode_draco(np.zeros((2, 3)), bits)


def test_wrong_point_count_is_refused():
    data, parameters, _ = encode_draco(np.random.default_rng(0).random((50, 3)), 16)
    with pytest.raises(ReelError, match="50 points, expected 51"):
        decode_draco(data, parameters, 51)
    with pytest.raises(ReelError, match="range"):
        decode_draco(data, parameters | {"range": float("nan")}, 50)


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_damaged_draco_raises_reel_error_or_decodes(seed):
    rng = np.random.default_rng(seed)
    data, parameters, _ = encode_draco(np.random.default_rng(0).random((200, 3)), 20)
    damaged = bytearray(data)
    for at in rng.integers(0, len(data), 4):
        damaged[at] = rng.integers(0, 256)
    del damaged[rng.integers(len(data) // 2, 2 * len(data)) :]
    with contextlib.suppress(ReelError):
        assert decode_draco(bytes(damaged), parameters, 200).shape == (200, 3)


def test_only_reels_of_the_papers_codec_need_dracopy(monkeypatch: pytest.MonkeyPatch) -> None:
    """Windows on ARM has no DracoPy."""
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    assert len(open_reel(PREDICTIVE).at(0)) > 0
    with pytest.raises(
        MissingDependencyError, match=r"h265.* needs DracoPy(.|\n)*pip install DracoPy(.|\n)*predictive"
    ):
        open_reel(GOLDEN).at(0)


def blobs(count=2000, centers=20, seed=0):
    rng = np.random.default_rng(seed)
    middle = rng.normal(size=(centers, 45))
    return (middle[rng.integers(0, centers, count)] + 0.01 * rng.normal(size=(count, 45))).astype(np.float32), middle


def test_kmeans_finds_clusters():
    vectors, _ = blobs()
    codebook = kmeans(vectors, 60)
    assert codebook.shape == (60, 45)
    _, distance = assign(vectors, codebook)
    assert distance.mean() < 0.02  # against 45 when nothing fits, 0.0045 for the blobs' own centers


def test_assign_returns_the_nearest_entry():
    vectors, _ = blobs(300)
    codebook = vectors[:40] + 0.1
    nearest, distance = assign(vectors, codebook)
    exact = ((vectors[:, None] - codebook) ** 2).sum(-1)
    np.testing.assert_allclose(exact[np.arange(300), nearest], exact.min(1), atol=1e-4)
    np.testing.assert_allclose(distance, exact.min(1), atol=1e-3)


def test_same_seed_same_codebook():
    vectors, _ = blobs()
    np.testing.assert_array_equal(kmeans(vectors, 32, seed=3), kmeans(vectors, 32, seed=3))


def test_few_vectors_are_kept_exactly():
    vectors = np.repeat(blobs(5)[0], 3, axis=0)
    codebook = kmeans(vectors, 1024)
    assert codebook.shape == (5, 45)
    nearest, _ = assign(vectors, codebook)
    np.testing.assert_array_equal(codebook[nearest], vectors)


def test_one_entry_is_the_mean():
    vectors = np.array([[0.0], [1.0], [5.0]], np.float32)
    np.testing.assert_allclose(kmeans(vectors, 1), [[2.0]])


def test_kmeans_favors_larger_weights():
    """A cloud with a hundred times the weight of another gets most of the entries, and its error falls."""
    rng = np.random.default_rng(0)
    vectors = np.concatenate([rng.normal(0, 1, (500, 6)), rng.normal(20, 1, (500, 6))]).astype(np.float32)
    weights = np.repeat([100.0, 1.0], 500)
    errors = [assign(vectors[:500], kmeans(vectors, 40, weights=w))[1].mean() for w in (None, weights)]
    codebook = kmeans(vectors, 40, weights=weights)
    assert (codebook.mean(1) < 10).sum() > 35
    assert errors[1] < 0.85 * errors[0]
    np.testing.assert_allclose(kmeans(np.array([[0.0], [3.0]], np.float32), 1, weights=np.array([2, 1])), [[1.0]])
