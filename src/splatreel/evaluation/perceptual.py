"""LPIPS by AlexNet and VGG-16 as matrix products, if their weights are on this machine (`lpips_weights.py`).

Source:
    Zhang et al. 2018, version 0.1 of their weights.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from splatreel.base.threads import run_ranges
from splatreel.evaluation.lpips_weights import LpipsWeights, load_weights

LEAST_SIDE = 32
"""Least width and height in pixels. Of a smaller image, the networks' strides leave nothing."""
SHIFT = np.array([-0.030, -0.088, -0.188], np.float32)
SCALE = np.array([0.458, 0.448, 0.450], np.float32)
STRIP, LEAST_PRODUCT = 1 << 18, 512
"""Numbers in the windows of a strip, 1 MB, which a core's cache holds until their product; least windows, for the product's speed."""


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
    """Distances of two images in each layer of a network, float32 [H', W']."""

    layers: list[np.ndarray]

    def mean(self, where: np.ndarray | None = None) -> float:
        """Return the distance over all pixels, or over those in a mask [H, W] bool."""
        if where is None:
            return sum(float(distance.mean()) for distance in self.layers)
        import cv2  # 60 ms, for masks only

        size = where.shape[::-1]
        return sum(float(cv2.resize(distance, size)[where].mean()) for distance in self.layers)


class Lpips:
    """LPIPS with one network.

    Args:
        network: alex or vgg.
        weights: Weights of the network.
    """

    def __init__(self, network: str, weights: LpipsWeights) -> None:
        self.layers = NETWORKS[network]
        self.weights = weights

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
        pair = (np.asarray(i, np.float32) for i in (image, truth))
        first, second = (self._compared(((i * 2 - 1 if shifted else i) - SHIFT) / SCALE) for i in pair)
        return LpipsDistances([_distances(*layers) for layers in zip(first, second, self.weights.heads, strict=True)])

    def _compared(self, x: np.ndarray) -> Iterator[np.ndarray]:
        """Yield the features [H', W', C] that LPIPS compares, one layer after the other."""
        for layer, (kernel, bias) in zip(self.layers, self.weights.convolutions, strict=True):
            if layer.pool:
                x = max_pool(x, layer.pool)
            x = convolve(x, kernel, bias, layer.stride, layer.padding)
            if layer.compared:
                yield x


def _distances(first: np.ndarray, second: np.ndarray, head: np.ndarray) -> np.ndarray:
    """Return the weighted squared distances [H, W] of features [H, W, C] of unit length."""
    first, second = (
        x / (np.sqrt(np.einsum("hwc,hwc->hw", x, x)) + np.float32(1e-10))[..., None] for x in (first, second)
    )
    first -= second
    first *= first
    return first @ head


def max_pool(x: np.ndarray, size: int) -> np.ndarray:
    """Return the maxima of an image [H, W, C] over windows of `size` pixels at a stride of 2, without partial windows."""
    for _ in range(2):  # rows, then columns
        count = (len(x) - size) // 2 + 1
        maxima = x[0 : 2 * count : 2]
        for offset in range(1, size):
            maxima = np.maximum(maxima, x[offset : offset + 2 * count - 1 : 2])
        x = maxima.swapaxes(0, 1)
    return x


def convolve(x: np.ndarray, kernel: np.ndarray, bias: np.ndarray, stride: int = 1, padding: int = 0) -> np.ndarray:
    """Return the ReLU of a convolution of an image: matrix products of its windows with the kernel, strip by strip.

    Args:
        x: Image, float32 [H, W, I].
        kernel: Kernel, float32 [K, K, I, O].
        bias: Bias, float32 [O].
        stride: Stride of the windows.
        padding: Rows and columns of zeros around the image.
    """
    size, matrix = len(kernel), kernel.reshape(-1, kernel.shape[3])
    padded = np.zeros((x.shape[0] + 2 * padding, x.shape[1] + 2 * padding, x.shape[2]), np.float32)
    padded[padding : padding + x.shape[0], padding : padding + x.shape[1]] = x
    windows = sliding_window_view(padded, (size, size), (0, 1))[::stride, ::stride].transpose(0, 1, 3, 4, 2)
    height, width = windows.shape[:2]
    out = np.empty((height, width, len(bias)), np.float32)
    rows = -(-max(LEAST_PRODUCT, STRIP // len(matrix)) // width)

    def fill(first: int, last: int) -> None:
        for row in range(first * rows, min(last * rows, height), rows):
            strip = out[row : row + rows].reshape(-1, len(bias))
            np.matmul(windows[row : row + rows].reshape(-1, len(matrix)), matrix, out=strip)
            strip += bias
            np.maximum(strip, 0, out=strip)

    strips = -(-height // rows)
    run_ranges(fill, strips, (), chunks=strips)
    return out


def load_lpips() -> dict[str, Lpips]:
    """Return LPIPS by network, alex and vgg. Networks without weights on this machine are left out.

    Raises:
        MissingDependencyError: A file of weights is damaged.
    """
    found = {network: load_weights(network) for network in NETWORKS}
    return {network: Lpips(network, weights) for network, weights in found.items() if weights is not None}
