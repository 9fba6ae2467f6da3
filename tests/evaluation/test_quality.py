import dataclasses
from collections.abc import Mapping

import numpy as np
import pytest

from splatreel.evaluation.metrics import Moments, dssim, psnr, psnr_color_fitted, psnr_per_channel, ssim, ssim_skimage
from splatreel.evaluation.perceptual import Lpips, LpipsDistances
from splatreel.evaluation.quality import ImageComparison, Quality

REAL_MOMENTS = Moments.of


class FakeLpips(Lpips):
    """Mean absolute difference in place of a network."""

    def __init__(self, factor: float) -> None:
        self.factor = factor

    def distances(self, image: np.ndarray, truth: np.ndarray, shifted: bool = True) -> LpipsDistances:
        scale = self.factor if shifted else self.factor / 2
        return LpipsDistances([scale * np.abs(image - truth).mean(-1)])


LPIPS: Mapping[str, Lpips] = {"alex": FakeLpips(1), "vgg": FakeLpips(2)}


def test_mean_averages_each_metric() -> None:
    a, b = Quality(30.0, 31.0, 0.9, 0.1, 0.2, 0.8, 0.1, 0.05), Quality(32.0, 33.0, 0.8, 0.3, 0.4, 0.6, 0.2, 0.15)
    assert dataclasses.astuple(Quality.mean([a, b]))[:8] == pytest.approx((31.0, 32.0, 0.85, 0.2, 0.3, 0.7, 0.15, 0.1))
    assert Quality.mean([a, dataclasses.replace(b, lpips=None)]).lpips == 0.1
    assert Quality.mean([Quality(1, 1, 1)]).lpips is None


def test_measure_fills_all_metrics_of_an_image_and_of_its_masked_part() -> None:
    truth = np.random.default_rng(0).random((40, 40, 3), np.float32) * 0.8
    image = truth.copy()
    image[:20] += 0.1
    upper = np.arange(40)[:, None].repeat(40, 1) < 20
    compared = ImageComparison(image, truth, LPIPS)
    whole, masked = compared.quality(), compared.quality(upper)
    assert all(value is not None for value in dataclasses.astuple(whole))
    assert (masked.psnr, masked.lpips_alex, masked.lpips) == pytest.approx((20, 0.1, 0.2), abs=1e-4)
    assert (whole.lpips_alex, whole.lpips) == pytest.approx((0.05, 0.1), abs=1e-4)
    assert whole.ssim_skimage == ssim_skimage(image, truth)
    one, two, upper_one = (float(value or 0) for value in (whole.dssim1, whole.dssim2, masked.dssim1))
    assert one == pytest.approx((1 - float(whole.ssim_skimage or 0)) / 2)
    assert 0 < two < one < upper_one
    assert (masked.lpips_3dgs, whole.lpips_3dgs) == pytest.approx((0.1, 0.05), abs=1e-4)
    assert ImageComparison(image, truth, {}).quality().lpips is None
    assert whole.psnr == psnr(image, truth)
    assert masked.psnr_per_channel == psnr_per_channel(image, truth, upper)
    assert (whole.ssim, masked.ssim) == (ssim(image, truth), ssim(image, truth, upper))
    assert whole.dssim2 == dssim(ssim_skimage(image, truth, data_range=2.0))
    assert whole.psnr_color_fitted == psnr_color_fitted(image, truth)


def test_each_pair_is_filtered_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The masks and both data ranges share the maps of a Gaussian and of a uniform window."""
    calls = []
    monkeypatch.setattr(Moments, "of", lambda *given: calls.append(given) or REAL_MOMENTS(*given))
    truth = np.random.default_rng(0).random((40, 40, 3), np.float32)
    compared = ImageComparison(truth * 0.5, truth, {})
    for where in (None, truth[..., 0] > 0.5, truth[..., 1] > 0.5):
        compared.quality(where)
    assert len(calls) == 2


def test_colors_of_a_camera_do_not_count_for_fitted_psnr() -> None:
    """The gains are those of the whole image, so that a masked part cannot hide its own errors."""
    truth = np.random.default_rng(0).random((40, 40, 3), np.float32) * 0.8
    image = truth * np.array([0.8, 0.9, 1.1], np.float32)
    upper = np.arange(40)[:, None].repeat(40, 1) < 20
    found = ImageComparison(image, truth, {}).quality(upper)
    assert found.psnr < 25
    assert float(found.psnr_color_fitted or 0) > 80
    image[:20] *= 0.5
    assert float(ImageComparison(image, truth, {}).quality(upper).psnr_color_fitted or 0) < 20
    assert ImageComparison(image, truth, {}, upper).quality(upper).psnr_color_fitted > 80  # the masks of a subject
    within = ImageComparison(np.zeros_like(truth), truth, {}).quality()
    assert within.psnr_color_fitted == within.psnr  # a black image has no gain
