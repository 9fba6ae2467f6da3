"""Quality of an image by all metrics."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from splatreel.evaluation import metrics
from splatreel.evaluation.perceptual import Lpips


@dataclass(frozen=True)
class Quality:
    """Image quality of one image, or the mean over several. A metric that was not measured is None.

    Attributes:
        psnr: PSNR in dB over all pixels and channels.
        psnr_per_channel: Mean of the PSNR of each channel, in dB.
        ssim: Structural similarity as the code of 3DGS computes it.
        lpips: LPIPS with VGG-16.
        lpips_alex: LPIPS with AlexNet.
        ssim_skimage: Structural similarity as scikit-image computes it, with a data range of 1.
        dssim1: (1 - SSIM) / 2 of scikit-image's SSIM with a data range of 1.
        dssim2: The same with a data range of 2, as papers get that leave the range of float images to scikit-image.
        psnr_color_fitted: PSNR in dB after the best gain for each color channel of the whole image.
        lpips_3dgs: LPIPS with VGG-16 as the code of 3DGS and most code that descends from it computes it: the network gets
            values of 0..1 where it expects -1..1, which gives about 9 % lower distances.
    """

    psnr: float
    psnr_per_channel: float
    ssim: float
    lpips: float | None = None
    lpips_alex: float | None = None
    ssim_skimage: float | None = None
    dssim1: float | None = None
    dssim2: float | None = None
    psnr_color_fitted: float | None = None
    lpips_3dgs: float | None = None

    @staticmethod
    def mean(items: list[Quality]) -> Quality:
        """Return the arithmetic mean of each metric over the items that have it. There must be an item."""
        names = [field.name for field in dataclasses.fields(Quality)]
        values = {name: [v for item in items if (v := getattr(item, name)) is not None] for name in names}
        return Quality(**{name: sum(found) / len(found) for name, found in values.items() if found})


class ImageComparison:
    """Comparison of an image with its truth. What every mask needs is computed once.

    Args:
        image: Rendered image, float32 [H, W, 3] 0..1.
        truth: Camera image of the same shape.
        lpips: LPIPS by network, alex and vgg; those left out are not measured.
        within: Pixels that colors are fitted to, [H, W] bool; None means all.

    Raises:
        UsageError: The shapes differ.
    """

    def __init__(
        self, image: np.ndarray, truth: np.ndarray, lpips: Mapping[str, Lpips], within: np.ndarray | None = None
    ) -> None:
        metrics.check_images(image, truth, within)
        self._images = image, truth
        self._error = metrics.squared_error(image, truth)
        self._fitted = metrics.squared_error(metrics.fit_colors(image, truth, within), truth)
        self._gaussian = metrics.gaussian_moments(image, truth).similarity(1.0)
        has_windows = min(image.shape[:2]) >= metrics.UNIFORM_WINDOW
        uniform = metrics.uniform_moments(image, truth) if has_windows else None
        self._uniform = [uniform and uniform.similarity(data_range) for data_range in (1.0, 2.0)]
        self._lpips = {network: lpips[network].distances(image, truth) for network in lpips}
        if "vgg" in lpips:
            self._lpips["3dgs"] = lpips["vgg"].distances(image, truth, shifted=False)

    def quality(self, where: np.ndarray | None = None) -> Quality:
        """Return all metrics over the pixels of a mask [H, W] bool; None means all pixels.

        Raises:
            UsageError: The mask chooses no pixel, or has another shape.
        """
        metrics.check_images(*self._images, where)
        one, two = (None if map_ is None else metrics.mean_inside(map_, where) for map_ in self._uniform)
        perceived = {name: None if found is None else found.mean(where) for name, found in self._lpips.items()}
        return Quality(
            psnr=metrics.mean_decibel(self._error, where),
            psnr_per_channel=metrics.mean_decibel_per_channel(self._error, where),
            ssim=float(np.mean(self._gaussian if where is None else self._gaussian[where])),
            lpips=perceived.get("vgg"),
            lpips_alex=perceived.get("alex"),
            ssim_skimage=one,
            dssim1=metrics.dssim(one),
            dssim2=metrics.dssim(two),
            psnr_color_fitted=metrics.mean_decibel(self._fitted, where),
            lpips_3dgs=perceived.get("3dgs"),
        )
