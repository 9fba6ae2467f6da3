"""Changes of a sequence while it is read."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from splatreel.base.errors import GaussiansError
from splatreel.importing.edits import Edit, EditedFrames, distant_origin, first_points
from splatreel.importing.frames import open_frames
from splatreel.scene.gaussians import Gaussians
from tests.importing.films import cameras, frame, write_film

ZERO = np.zeros(3)


def film(folder: Path, frames: list[Gaussians], edit: Edit) -> EditedFrames:
    return EditedFrames(open_frames(write_film(folder, frames)), edit)


def test_crop_scale_and_opacity(tmp_path: Path) -> None:
    points = frame(0)
    faint = replace(points, opacities=np.where(np.arange(len(points)) % 3, 0.9, 0.2))
    crop = np.array([[-1.0, -1, -1], [1, 1, 2]])
    edited = film(tmp_path, [faint], Edit(np.array([0.5, 0, 0]), 10.0, crop, 0.3))
    kept = ((points.means >= crop[0]) & (points.means <= crop[1])).all(1) & (faint.opacities > 0.3)
    found = edited.read(0)
    assert 0 < kept.sum() < len(points)
    np.testing.assert_allclose(found.means, 10 * (points.means[kept] - [0.5, 0, 0]), atol=1e-4)
    np.testing.assert_allclose(found.scales, 10 * points.scales[kept], rtol=1e-5)
    shifted = edited.read(0, np.array([1.0, 2, 3]))
    np.testing.assert_allclose(shifted.means, found.means - np.array([1.0, 2, 3]), atol=1e-4)


def test_scaled_camera_sees_the_same_image() -> None:
    edit, camera = Edit(ZERO, 3.0), cameras()[1]
    moved = edit.camera(camera)
    point = np.array([0.2, -0.1, 0.3, 1.0])
    before, after = camera.viewmat @ point, moved.viewmat @ (point * [3, 3, 3, 1])
    np.testing.assert_allclose(after[:2] / after[2], before[:2] / before[2], rtol=1e-5)


def test_origin_moves_only_when_float32_is_too_coarse() -> None:
    points = frame(0)
    assert not distant_origin(points).any()
    assert not distant_origin(replace(points, means=points.means + 1000)).any()
    far = np.array([448_000.0, 5_411_000.0, 300.0])
    found = distant_origin(replace(points, means=(points.means + far).astype(np.float32)))
    assert np.abs(found - far).max() < 3
    assert (found == np.round(found)).all()


def test_first_frames_may_be_empty(tmp_path: Path) -> None:
    edited = film(tmp_path / "film", [frame(0)[:0], frame(1)], Edit(ZERO))
    assert len(first_points(edited)) == len(frame(1))
    with pytest.raises(GaussiansError, match=r"no frame holds a point\. Check --crop"):
        first_points(film(tmp_path / "none", [frame(0)], Edit(ZERO, crop=np.array([[50.0] * 3, [51.0] * 3]))))
