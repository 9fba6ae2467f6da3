"""SPZ files, read by a decoder written from the format's description."""

import gzip
import struct
from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import GaussiansError
from splatreel.formats.spz import write_spz
from splatreel.scene.gaussians import Gaussians
from tests.golden import random_gaussians


def read_spz(path: Path) -> Gaussians:
    """Read a file, with its own axes."""
    data = gzip.decompress(path.read_bytes())
    magic, version, n, degree, bits, flags, zero = struct.unpack_from("<IIIBBBB", data)
    assert (magic, version, flags, zero) == (0x5053474E, 3, 0, 0)
    rest = (degree + 1) ** 2 - 1
    sizes = [9 * n, n, 3 * n, 3 * n, 4 * n, 3 * rest * n]
    assert len(data) == 16 + sum(sizes)
    ends = np.cumsum([16, *sizes])
    columns = [np.frombuffer(data, np.uint8, size, start) for size, start in zip(sizes, ends, strict=False)]
    three = columns[0].reshape(-1, 3).astype(np.int64) @ [1, 256, 65536]
    means = (three - (three >> 23 << 24)).reshape(n, 3) / (1 << bits)
    harmonics = np.concatenate(
        [(columns[2].reshape(n, 1, 3) / 255 - 0.5) / 0.15, columns[5].reshape(n, rest, 3) / 128 - 1], 1
    )
    return Gaussians(
        means=means,
        quats=rotations(columns[4].view("<u4")),
        scales=np.exp(columns[3].reshape(n, 3) / 16 - 10),
        opacities=columns[1] / 255,
        sh=harmonics,
    )


def rotations(codes: np.ndarray) -> np.ndarray:
    """Return [N, 4] wxyz of the three smallest components; the last is in the lowest bits."""
    xyzw = np.zeros((len(codes), 4))
    for i, code in enumerate(codes.tolist()):
        largest = code >> 30
        for part in (3, 2, 1, 0):
            if part != largest:
                xyzw[i, part] = (-1 if code >> 9 & 1 else 1) * (code & 511) / 511 / np.sqrt(2)
                code >>= 10
        xyzw[i, largest] = np.sqrt(1 - (xyzw[i] ** 2).sum())
    return np.roll(xyzw, 1, axis=1)


@pytest.mark.parametrize("degree", [0, 1, 3])
def test_spz_round_trips_within_a_step(tmp_path: Path, degree: int) -> None:
    given = random_gaussians(np.random.default_rng(degree), 200, degree, (1, -2, 3))
    given.sh[:, 1:] = np.clip(given.sh[:, 1:], -0.9, 0.9)
    write_spz(tmp_path / "f.spz", given)
    back = read_spz(tmp_path / "f.spz")
    assert np.abs(back.means - given.means).max() < 1e-6
    turned = back.quats * np.sign((back.quats * given.quats).sum(1, keepdims=True))
    assert np.abs(turned - given.quats).max() < 0.003
    assert np.abs(np.log(back.scales / given.scales)).max() <= 1 / 32 + 1e-4
    assert np.abs(back.opacities - given.opacities).max() <= 0.5 / 255 + 1e-6
    base = np.clip(given.sh[:, 0], -0.5 / 0.15, 0.5 / 0.15)
    assert np.abs(back.sh[:, 0] - base).max() <= 0.5 / 255 / 0.15 + 1e-5
    if degree:
        assert np.abs(back.sh[:, 1:4] - given.sh[:, 1:4]).max() <= 5 / 128
        assert np.abs(back.sh[:, 4:] - given.sh[:, 4:]).max(initial=0) <= 9 / 128


def test_spz_without_points(tmp_path: Path) -> None:
    write_spz(tmp_path / "f.spz", Gaussians.empty(1))
    assert len(read_spz(tmp_path / "f.spz")) == 0
    write_spz(tmp_path / "f.spz", Gaussians.empty(1), antialias=True)
    assert gzip.decompress((tmp_path / "f.spz").read_bytes())[14] == 1


def test_spz_refuses_distant_points(tmp_path: Path) -> None:
    far = Gaussians(
        np.array([[1e7, 0, 0]]), np.array([[1.0, 0, 0, 0]]), np.ones((1, 3)), np.ones(1), np.zeros((1, 1, 3))
    )
    with pytest.raises(GaussiansError, match="too far"):
        write_spz(tmp_path / "f.spz", far)
