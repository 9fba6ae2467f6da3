"""LPIPS by AlexNet and VGG-16 in plain PyTorch, if their weights are on this machine (`lpips_weights.py`).

Source:
    Zhang et al. 2018, version 0.1 of their weights.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from torch import Tensor

    from splatreel.evaluation.lpips_weights import LpipsWeights

LEAST_SIDE = 32
"""Least width and height in pixels. Of a smaller image, the networks' strides leave nothing."""
SHIFT = (-0.030, -0.088, -0.188)
SCALE = (0.458, 0.448, 0.450)


@dataclass(frozen=True)
class Layer:
    """A convolution followed by a ReLU.

    Attributes:
        stride: Stride of the convolution.
        padding: Padding of the convolution with zeros.
        pool: Size of the max pooling of stride 2 before the convolution; 0 for none.
        compared: Whether LPIPS compares the result.
    """

    stride: int = 1
    padding: int = 1
    pool: int = 0
    compared: bool = True


QUIET = Layer(compared=False)
NETWORKS: dict[str, tuple[Layer, ...]] = {
    "alex": (Layer(stride=4, padding=2), Layer(padding=2, pool=3), Layer(pool=3), Layer(), Layer()),
    "vgg": (
        *(QUIET, Layer()),
        *(Layer(pool=2, compared=False), Layer()),
        *(Layer(pool=2, compared=False), QUIET, Layer()) * 3,
    ),
}
"""Layers of each network up to the last one that LPIPS compares."""


@dataclass(frozen=True)
class LpipsDistances:
    """Distances of two images in each layer of a network, [1, 1, H', W']."""

    layers: list[Tensor]

    def mean(self, where: np.ndarray | None = None) -> float:
        """Return the distance over all pixels, or over those in a mask [H, W] bool."""
        import torch
        from torch.nn.functional import interpolate

        total = 0.0
        for distance in self.layers:
            if where is not None:
                mask = torch.from_numpy(where).to(distance.device)
                distance = interpolate(distance, size=where.shape, mode="bilinear")[0, 0][mask]
            total += float(distance.mean())
        return total


class Lpips:
    """LPIPS with one network.

    Args:
        network: alex or vgg.
        weights: Weights of the network.
    """

    def __init__(self, network: str, weights: LpipsWeights) -> None:
        import torch

        self.device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        self.layers = NETWORKS[network]
        self.convolutions = [(k.to(self.device), b.to(self.device)) for k, b in weights.convolutions]
        self.heads = [head.to(self.device) for head in weights.heads]

    def __call__(self, image: np.ndarray, truth: np.ndarray, where: np.ndarray | None = None) -> float | None:
        """Return the distance of two images; 0 for equal ones. The order of the two does not matter.

        Args:
            image: Float image [H, W, 3], sRGB 0..1.
            truth: Image to compare with, of the same shape.
            where: Pixels to measure, [H, W] bool; None means all. The networks still see the whole images.

        Returns:
            The distance, or None for images under 32 pixels on a side.
        """
        found = self.distances(image, truth)
        return None if found is None else found.mean(where)

    def distances(self, image: np.ndarray, truth: np.ndarray, shifted: bool = True) -> LpipsDistances | None:
        """Return the distances of two images by pixel, or None for images under 32 pixels on a side.

        Args:
            image: Float image [H, W, 3], sRGB 0..1.
            truth: Image to compare with, of the same shape.
            shifted: The network gets values of -1..1, which it was trained for. False gives it 0..1, as the code of 3DGS does.
        """
        if min(image.shape[:2]) < LEAST_SIDE:
            return None
        import torch

        pair = np.stack([image, truth]).astype(np.float32)
        found = []
        with torch.no_grad():
            x = torch.from_numpy(pair).to(self.device).permute(0, 3, 1, 2)
            x = x * 2 - 1 if shifted else x
            x = (x - x.new_tensor(SHIFT)[:, None, None]) / x.new_tensor(SCALE)[:, None, None]
            for features, head in zip(self._compared(x), self.heads, strict=True):
                unit = features / (features.square().sum(1, keepdim=True).sqrt() + 1e-10)
                found.append(((unit[:1] - unit[1:]).square() * head).sum(1, keepdim=True))
        return LpipsDistances(found)

    def _compared(self, x: Tensor) -> Iterator[Tensor]:
        """Yield the features that LPIPS compares, one layer after the other."""
        from torch.nn.functional import conv2d, max_pool2d

        for layer, (kernel, bias) in zip(self.layers, self.convolutions, strict=True):
            if layer.pool:
                x = max_pool2d(x, layer.pool, stride=2)
            x = conv2d(x, kernel, bias, stride=layer.stride, padding=layer.padding).relu_()
            if layer.compared:
                yield x


def load_lpips() -> dict[str, Lpips]:
    """Return LPIPS by network, alex and vgg. Networks without weights on this machine are left out.

    Raises:
        MissingDependencyError: A file of weights is damaged.
    """
    if importlib.util.find_spec("torch") is None:
        return {}
    from splatreel.evaluation.lpips_weights import load_weights

    found = {network: load_weights(network) for network in NETWORKS}
    return {network: Lpips(network, weights) for network, weights in found.items() if weights is not None}
