"""Quality of an image by all metrics."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from splatreel.evaluation.metrics import dssim, psnr, psnr_per_channel, ssim, ssim_skimage
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
    """

    psnr: float
    psnr_per_channel: float
    ssim: float
    lpips: float | None = None
    lpips_alex: float | None = None
    ssim_skimage: float | None = None
    dssim1: float | None = None
    dssim2: float | None = None

    @staticmethod
    def mean(items: list[Quality]) -> Quality:
        """Return the arithmetic mean of each metric over the items that have it. There must be an item."""
        names = [field.name for field in dataclasses.fields(Quality)]
        values = {name: [v for item in items if (v := getattr(item, name)) is not None] for name in names}
        return Quality(**{name: sum(found) / len(found) for name, found in values.items() if found})


def measure(
    image: np.ndarray, truth: np.ndarray, lpips: Mapping[str, Lpips], where: np.ndarray | None = None
) -> Quality:
    """Return all metrics of an image against its truth, both float32 [H, W, 3] 0..1.

    Args:
        image: Rendered image.
        truth: Camera image.
        lpips: LPIPS by network, alex and vgg; those left out are not measured.
        where: Pixels to measure, [H, W] bool; None means all.
    """
    pair = image, truth, where
    similarity = ssim_skimage(*pair)
    distances = {network: distance(*pair) for network, distance in lpips.items()}
    return Quality(
        psnr=psnr(*pair),
        psnr_per_channel=psnr_per_channel(*pair),
        ssim=ssim(*pair),
        lpips=distances.get("vgg"),
        lpips_alex=distances.get("alex"),
        ssim_skimage=similarity,
        dssim1=dssim(similarity),
        dssim2=dssim(ssim_skimage(*pair, data_range=2.0)),
    )
