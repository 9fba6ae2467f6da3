"""Metrics of images and of flicker."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from splatreel.base.errors import UsageError
from splatreel.codec.reader import ReelReader
from splatreel.evaluation.metrics import (
    PSNR_MAX,
    Flicker,
    border_frames,
    dssim,
    psnr,
    psnr_per_channel,
    ssim,
    ssim_skimage,
)
from tests.evaluation import scenes


def gray(value: float, shape: tuple[int, int, int] = (20, 30, 3)) -> np.ndarray:
    return np.full(shape, value, np.float32)


def noise(seed: int, shape: tuple[int, int, int] = (20, 30, 3)) -> np.ndarray:
    return np.random.default_rng(seed).random(shape, np.float32)


def test_psnr_of_a_constant_difference_is_known() -> None:
    assert psnr(gray(0.5), gray(0.6)) == pytest.approx(20.0, abs=1e-4)
    assert psnr_per_channel(gray(0.5), gray(0.6)) == pytest.approx(20.0, abs=1e-4)


def test_psnr_pools_channels_and_psnr_per_channel_averages_them() -> None:
    image = gray(0.5)
    image[..., 0] += 0.1
    image[..., 1] += 0.01
    image[..., 2] += 0.001
    assert psnr(image, gray(0.5)) == pytest.approx(-10 * np.log10((1e-2 + 1e-4 + 1e-6) / 3), abs=1e-3)
    assert psnr_per_channel(image, gray(0.5)) == pytest.approx(40.0, abs=1e-2)


def test_equal_images_score_the_maximum() -> None:
    assert psnr(noise(0), noise(0)) == PSNR_MAX
    assert ssim(noise(0), noise(0)) == pytest.approx(1.0, abs=1e-6)


def half() -> np.ndarray:
    """Return a mask of the upper ten rows."""
    return np.arange(20)[:, None].repeat(30, 1) < 10


def test_metrics_use_only_masked_pixels() -> None:
    image = gray(0.5)
    image[half()] += 0.1
    for metric in (psnr, psnr_per_channel):
        assert metric(image, gray(0.5), half()) == pytest.approx(20, abs=1e-4)
        assert metric(image, gray(0.5), ~half()) == PSNR_MAX
    image = noise(1)
    image[half()] = noise(2)[half()]
    both = [ssim(image, noise(1), mask) for mask in (half(), ~half())]
    assert both[0] < 0.3 < 0.8 < both[1] < 1  # windows reach across
    assert np.mean(both) == pytest.approx(ssim(image, noise(1)), abs=1e-6)


@pytest.mark.parametrize("mask", [np.zeros((20, 30), bool), np.ones((20, 31), bool), np.ones((20, 30))])
def test_empty_masks_are_refused(mask: np.ndarray) -> None:
    for metric in (psnr, psnr_per_channel, ssim, ssim_skimage):
        with pytest.raises(UsageError, match="does not choose pixels"):
            metric(noise(1), noise(2), mask)


def slow_ssim(x: np.ndarray, y: np.ndarray) -> float:
    """Compute SSIM by its definition with 121 explicit weights and zero padding."""
    line = np.exp(-((np.arange(11) - 5.0) ** 2) / (2 * 1.5**2))
    weights = np.outer(line, line) / line.sum() ** 2

    def mean(image: np.ndarray) -> np.ndarray:
        padded = np.pad(image.astype(np.float64), ((5, 5), (5, 5), (0, 0)))
        windows = np.lib.stride_tricks.sliding_window_view(padded, (11, 11), (0, 1))
        return (windows * weights).sum((-1, -2))

    mean_x, mean_y = mean(x), mean(y)
    var_x, var_y, covariance = mean(x * x) - mean_x**2, mean(y * y) - mean_y**2, mean(x * y) - mean_x * mean_y
    above = (2 * mean_x * mean_y + 0.01**2) * (2 * covariance + 0.03**2)
    return float((above / ((mean_x**2 + mean_y**2 + 0.01**2) * (var_x + var_y + 0.03**2))).mean())


def test_ssim_agrees_with_its_definition() -> None:
    assert ssim(noise(1), noise(2)) == pytest.approx(slow_ssim(noise(1), noise(2)), abs=1e-5)


def slow_ssim_skimage(x: np.ndarray, y: np.ndarray, data_range: float) -> float:
    """Compute SSIM by explicit windows of 7x7 pixels inside the image, with the variances of a sample."""
    a, b = (
        np.lib.stride_tricks.sliding_window_view(i.astype(np.float64), (7, 7), (0, 1)).reshape(-1, 49) for i in (x, y)
    )
    mean_a, mean_b = a.mean(1), b.mean(1)
    covariance = ((a - mean_a[:, None]) * (b - mean_b[:, None])).sum(1) / 48
    c1, c2 = (0.01 * data_range) ** 2, (0.03 * data_range) ** 2
    above = (2 * mean_a * mean_b + c1) * (2 * covariance + c2)
    return float((above / ((mean_a**2 + mean_b**2 + c1) * (a.var(1, ddof=1) + b.var(1, ddof=1) + c2))).mean())


@pytest.mark.parametrize(("data_range", "known"), [(1.0, 0.0152018), (2.0, 0.0306473)])
def test_ssim_skimage_agrees_with_its_definition_and_with_scikit_image(data_range: float, known: float) -> None:
    value = ssim_skimage(noise(1), noise(2), data_range=data_range)
    assert value == pytest.approx(slow_ssim_skimage(noise(1), noise(2), data_range), abs=1e-9)
    assert value == pytest.approx(known, abs=1e-6)  # of scikit-image 0.26, structural_similarity


def test_ssim_skimage_needs_a_whole_window() -> None:
    assert ssim_skimage(noise(1, (6, 30, 3)), noise(2, (6, 30, 3))) is None
    corner = np.zeros((20, 30), bool)
    corner[:3, :3] = True
    assert ssim_skimage(noise(1), noise(2), corner) is None
    corner[3, 3] = True
    assert ssim_skimage(noise(1), noise(2), corner) is not None


def test_dssim_of_equal_images_is_zero() -> None:
    assert dssim(ssim_skimage(noise(1), noise(1))) == pytest.approx(0, abs=1e-12)
    assert dssim(-1.0) == 1
    assert dssim(None) is None


@given(st.integers(0, 1000), st.floats(0.01, 0.3))
def test_metrics_fall_with_noise(seed: int, amount: float) -> None:
    truth, disturbance = noise(seed), noise(seed + 1) - 0.5
    little, much = truth + amount * disturbance, truth + 2 * amount * disturbance
    assert psnr(little, truth) == pytest.approx(psnr(much, truth) + 20 * np.log10(2), abs=1e-2)
    assert ssim(little, truth) > ssim(much, truth)
    assert psnr_per_channel(little, truth) >= psnr(little, truth) - 1e-6


def test_ssim_is_symmetric() -> None:
    assert ssim(noise(1), noise(2)) == pytest.approx(ssim(noise(2), noise(1)), abs=1e-6)


@pytest.mark.parametrize("metric", [psnr, psnr_per_channel, ssim, ssim_skimage])
def test_images_of_different_shapes_are_refused(metric) -> None:
    with pytest.raises(UsageError, match=r"\(20, 30, 3\).*\(20, 31, 3\)"):
        metric(gray(0.5), gray(0.5, (20, 31, 3)))
    with pytest.raises(UsageError, match="uint8"):
        metric(np.zeros((4, 4, 3), np.uint8), np.zeros((4, 4, 3), np.uint8))


def make_images(levels: list[float]) -> list[np.ndarray]:
    return [np.full((4, 6, 3), level / 255, np.float32) for level in levels]


def test_motion_like_the_truth_has_no_flicker() -> None:
    flicker = Flicker(set())
    truths = make_images([10, 30, 90, 20])
    for frame, truth in enumerate(truths):
        flicker.add(frame, "a", truth + 0.1, truth)
    assert flicker.mean(at_borders=False) == pytest.approx(0, abs=1e-3)
    assert flicker.mean(at_borders=True) is None


def test_flicker_separates_borders_from_other_frames() -> None:
    flicker = Flicker({2})
    truth = make_images([50])[0]
    for frame, image in enumerate(make_images([50, 51, 56, 56])):
        for camera in ("a", "b"):
            flicker.add(frame, camera, image, truth)
    assert flicker.mean(at_borders=True) == pytest.approx(5, abs=1e-3)
    assert flicker.mean(at_borders=False) == pytest.approx(0.5, abs=1e-3)


def test_flicker_ignores_nonconsecutive_frames() -> None:
    flicker = Flicker(set())
    for frame, image in zip([0, 4, 8], make_images([0, 50, 100]), strict=True):
        flicker.add(frame, "a", image, image * 0)
    assert flicker.mean(at_borders=False) is None


def test_border_frames_cover_cross_fades_and_cuts(tmp_path) -> None:
    manifest = ReelReader(scenes.write_reel(tmp_path / "reel")).manifest
    assert border_frames(manifest) == set(), "one group has none"
    first = manifest.groups[0]
    two = [first, dataclasses.replace(first, first_frame=30)]
    assert border_frames(dataclasses.replace(manifest, groups=two, overlap=3)) == {31, 32, 33}
    assert border_frames(dataclasses.replace(manifest, groups=two, overlap=0)) == {30}
