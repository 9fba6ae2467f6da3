"""Files written by GaussianSplats3D 0.4.7 at its three levels of compression, in buckets of 16 points."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import GaussiansError
from splatreel.formats.registry import read_splats
from splatreel.formats.splat_columns import Remarks
from splatreel.scene.gaussians import C0, Gaussians
from tests.golden import random_gaussians

DATA = Path(__file__).parent.parent / "data" / "splats"


def given() -> Gaussians:
    """Return the points that the files were made of."""
    points = random_gaussians(np.random.default_rng(5), 60, 2, (1, -2, 3))
    return replace(points, means=points.means * 4)


@pytest.mark.parametrize("level", [0, 1, 2])
def test_points_of_all_levels(level: int) -> None:
    found, points = read_splats(DATA / f"level{level}.ksplat", None, Remarks()), given()
    assert len(found) == len(points)
    points = points[np.linalg.norm(found.means[:, None] - points.means, axis=2).argmin(1)]
    np.testing.assert_allclose(found.means, points.means, atol=1e-6 if level == 0 else 1e-4)
    np.testing.assert_allclose(found.scales, points.scales, rtol=1e-5 if level == 0 else 1e-3)
    np.testing.assert_allclose(np.abs((found.quats * points.quats).sum(1)), 1, atol=1e-5)
    np.testing.assert_allclose(found.opacities, points.opacities, atol=0.005)
    colors = np.clip(points.sh[:, 0] * C0 + 0.5, 0, 1)
    np.testing.assert_allclose(found.sh[:, 0] * C0 + 0.5, colors, atol=0.005)
    np.testing.assert_allclose(found.sh[:, 1:], points.sh[:, 1:], atol=(1e-6, 2e-4, 0.012)[level])


@pytest.mark.parametrize(
    ("at", "value", "said"),
    [
        (0, b"\x01", "version 1.1"),
        (20, b"\x03", "compression 3"),
        (4, b"\xff\xff\xff\xff", "4294967295 sections"),
        (4096, b"\xff\xff\x00\x00", "65535 of"),
        (4096 + 4, b"\xff\xff\xff\x00", "damaged .ksplat"),
        (4096 + 32, b"\xff\xff\x00\x00", "damaged .ksplat"),
        (4096 + 40, b"\x09", "of degree 9"),
    ],
)
def test_damaged_files_are_refused(tmp_path: Path, at: int, value: bytes, said: str) -> None:
    data = bytearray((DATA / "level1.ksplat").read_bytes())
    data[at : at + len(value)] = value
    if at == 4096 + 4:
        data[4096:4100] = value  # more points than the file has
    (tmp_path / "a.ksplat").write_bytes(data)
    with pytest.raises(GaussiansError, match=said):
        read_splats(tmp_path / "a.ksplat", None, Remarks())


def test_truncated_files_are_refused(tmp_path: Path) -> None:
    data = (DATA / "level2.ksplat").read_bytes()
    for size in (0, 1, 100, 5000, len(data) - 1):
        (tmp_path / "a.ksplat").write_bytes(data[:size])
        with pytest.raises(GaussiansError, match=r"damaged \.ksplat"):
            read_splats(tmp_path / "a.ksplat", None, Remarks())
