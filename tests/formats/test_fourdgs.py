"""Scenes in the .4dgs format, written by its own library."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from splatreel.base.errors import GaussiansError
from splatreel.scene.gaussians import C0
from splatreel.sequence.opening import open_frames

fourdgs = pytest.importorskip("fourdgs")
N = 12


def write_scene(path: Path) -> Any:
    """Write a scene of 2 seconds: points move along x, and the last of them is there in the second second only."""
    rng = np.random.default_rng(0)
    turns = rng.normal(size=(N, 4))
    points = fourdgs.GaussianSet(
        positions=rng.uniform(-1, 1, (N, 3)).astype(np.float32),
        scales=rng.uniform(0.02, 0.1, (N, 3)).astype(np.float32),
        rotations=(turns / np.linalg.norm(turns, axis=1, keepdims=True)).astype(np.float32),
        colors=rng.uniform(0.1, 0.9, (N, 4)).astype(np.float32),
        motions=np.tile(np.array([0.5, 0, 0], np.float32), (N, 1)),
        mu_t=np.ones(N, np.float32),
        sigma_t=np.full(N, np.inf, np.float32),
        win_lo=np.where(np.arange(N) < N - 1, 0.0, 1.0),
        win_hi=np.full(N, 2.0),
    )
    fourdgs.write(str(path), points, 2.0)
    return points


def test_scene_is_sampled_in_time(tmp_path: Path) -> None:
    given = write_scene(tmp_path / "scene.4dgs")
    frames = open_frames(tmp_path / "scene.4dgs", fps=10)
    assert (len(frames), frames.fps, len(frames.read(3)), len(frames.read(15))) == (20, 10, N - 1, N)
    assert len(open_frames(tmp_path / "scene.4dgs")) == 60
    points = frames.read(15)
    order = [int(np.abs(given.colors[:, :3] - (sh * C0 + 0.5)).sum(1).argmin()) for sh in points.sh[:, 0]]
    expected = given.positions[order] + np.array([0.5, 0, 0]) * (1.55 - 1.0)
    np.testing.assert_allclose(points.means, expected, atol=5e-3)
    np.testing.assert_allclose(points.opacities, given.colors[order, 3], atol=0.01)
    np.testing.assert_allclose(points.scales, given.scales[order], rtol=0.05)
    cosines = (points.quats[:, [1, 2, 3, 0]] * given.rotations[order]).sum(1)
    np.testing.assert_allclose(np.abs(cosines), 1, atol=0.01)


def test_damaged_file_is_named(tmp_path: Path) -> None:
    (tmp_path / "scene.4dgs").write_bytes(b"no scene")
    with pytest.raises(GaussiansError, match=r"scene\.4dgs: is damaged"):
        open_frames(tmp_path / "scene.4dgs")
