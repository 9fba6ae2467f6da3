"""Files of one frame, read back by the readers of `splatreel import`. docs/exports.md names other programs that read them."""

from pathlib import Path

import numpy as np
import pytest

from splatreel.formats.registry import FRAME_FORMATS, HALF_TURN, Placement, format_of, read_splats
from splatreel.formats.splat_columns import Remarks
from splatreel.scene.gaussians import Gaussians, turned
from tests.golden import random_gaussians

NO_TURN = Placement(np.array([1.0, 0, 0, 0]))
ERRORS = {
    # format: place, rotation, log scale, opacity, base color, other colors
    "ply": (0, 1e-6, 1e-5, 1e-5, 0, 0),
    "compressed-ply": (0.002, 0.003, 0.01, 0.003, 0.02, 0.02),
    "splat": (0, 0.02, 1e-5, 0.003, 0.02, None),
    "sog": (2e-4, 0.006, 0.03, 0.003, 0.08, 0.25),
    "spz2": (1e-6, 0.15, 0.032, 0.003, 0.02, 0.08),
    "spz": (1e-6, 0.004, 0.032, 0.003, 0.02, 0.08),
    "spz4": (1e-6, 0.004, 0.032, 0.003, 0.02, 0.08),
}
"""Maximum errors of each format."""


def points(count: int, degree: int) -> Gaussians:
    """Return points whose base colors every format can hold."""
    given = random_gaussians(np.random.default_rng(degree), count, degree, (1, -2, 3))
    base = np.clip(given.sh[:, :1], -1.7, 1.7)
    return Gaussians(
        given.means, given.quats, given.scales, given.opacities, np.concatenate([base, given.sh[:, 1:]], 1)
    )


def in_order_of(back: Gaussians, given: Gaussians) -> Gaussians:
    """Return points in the order of others by their positions, which formats sort."""
    apart = np.linalg.norm(back.means[None] - given.means[:, None], axis=2)
    return back[apart.argmin(1)]


@pytest.mark.parametrize("degree", [0, 3])
@pytest.mark.parametrize("kind", list(ERRORS))
def test_points_are_kept_within_a_step(tmp_path: Path, kind: str, degree: int) -> None:
    pytest.importorskip("zstandard")
    given, path = points(300, degree), tmp_path / f"f{FRAME_FORMATS[kind].suffix}"
    placed = turned(given, HALF_TURN) if kind.startswith("spz") else given  # readers give the axes of PLY
    FRAME_FORMATS[kind].write(path, placed, NO_TURN)
    back = in_order_of(read_splats(path, None, Remarks()), given)
    place, turn, scale, opacity, base, rest = ERRORS[kind]
    assert np.abs(back.means - given.means).max() <= place + 1e-6
    same = back.quats * np.where((back.quats * given.quats).sum(1, keepdims=True) < 0, -1, 1)
    assert np.abs(same - given.quats).max() <= turn
    assert np.abs(np.log(back.scales / given.scales)).max() <= scale + 1e-4
    assert np.abs(back.opacities - given.opacities).max() <= opacity
    assert np.abs(back.sh[:, 0] - given.sh[:, 0]).max() <= base + 1e-5
    if rest is not None and degree:
        assert np.abs(back.sh[:, 1:] - given.sh[:, 1:]).max() <= rest + 1e-5


@pytest.mark.parametrize("kind", [kind for kind in ERRORS if kind not in ("ply", "splat")])
def test_files_are_smaller_than_ply_files(tmp_path: Path, kind: str) -> None:
    pytest.importorskip("zstandard")
    given = points(1000, 3)
    for name in ("ply", kind):
        FRAME_FORMATS[name].write(tmp_path / name, given, NO_TURN)
    assert (tmp_path / kind).stat().st_size < 0.4 * (tmp_path / "ply").stat().st_size


@pytest.mark.parametrize("kind", FRAME_FORMATS)
def test_a_single_point_can_be_written(tmp_path: Path, kind: str) -> None:
    pytest.importorskip("zstandard")
    path = tmp_path / f"f{FRAME_FORMATS[kind].suffix}"
    FRAME_FORMATS[kind].write(path, points(1, 3), NO_TURN)
    if kind != "glb":
        assert len(read_splats(path, None, Remarks())) == 1


def test_names_tell_the_format() -> None:
    names = {"a.ply": "ply", "a.compressed.ply": "compressed-ply", "b.2.sog": "sog", "a.spz": "spz", "a.obj": None}
    assert {name: format_of(Path(name)) for name in names} == names
