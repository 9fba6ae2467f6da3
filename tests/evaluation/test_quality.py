import dataclasses
from collections.abc import Mapping

import numpy as np
import pytest

from splatreel.evaluation.metrics import ssim_skimage
from splatreel.evaluation.perceptual import Lpips
from splatreel.evaluation.quality import Quality, measure


class FakeLpips(Lpips):
    """Mean absolute difference in place of a network."""

    def __init__(self, factor: float) -> None:
        self.factor = factor

    def __call__(self, image: np.ndarray, truth: np.ndarray, where: np.ndarray | None = None) -> float:
        difference = np.abs(image - truth).mean(-1)
        return self.factor * float(difference.mean() if where is None else difference[where].mean())


LPIPS: Mapping[str, Lpips] = {"alex": FakeLpips(1), "vgg": FakeLpips(2)}


def test_mean_averages_each_metric() -> None:
    a, b = Quality(30.0, 31.0, 0.9, 0.1, 0.2, 0.8, 0.1, 0.05), Quality(32.0, 33.0, 0.8, 0.3, 0.4, 0.6, 0.2, 0.15)
    assert dataclasses.astuple(Quality.mean([a, b])) == pytest.approx((31.0, 32.0, 0.85, 0.2, 0.3, 0.7, 0.15, 0.1))
    assert Quality.mean([a, dataclasses.replace(b, lpips=None)]).lpips == 0.1
    assert Quality.mean([Quality(1, 1, 1)]).lpips is None


def test_measure_fills_all_metrics_of_an_image_and_of_its_masked_part() -> None:
    truth = np.random.default_rng(0).random((40, 40, 3), np.float32) * 0.8
    image = truth.copy()
    image[:20] += 0.1
    upper = np.arange(40)[:, None].repeat(40, 1) < 20
    whole, masked = measure(image, truth, LPIPS), measure(image, truth, LPIPS, upper)
    assert all(value is not None for value in dataclasses.astuple(whole))
    assert (masked.psnr, masked.lpips_alex, masked.lpips) == pytest.approx((20, 0.1, 0.2), abs=1e-4)
    assert (whole.lpips_alex, whole.lpips) == pytest.approx((0.05, 0.1), abs=1e-4)
    assert whole.ssim_skimage == ssim_skimage(image, truth)
    one, two, upper_one = (float(value or 0) for value in (whole.dssim1, whole.dssim2, masked.dssim1))
    assert one == pytest.approx((1 - float(whole.ssim_skimage or 0)) / 2)
    assert 0 < two < one < upper_one
    assert measure(image, truth, {}).lpips is None
