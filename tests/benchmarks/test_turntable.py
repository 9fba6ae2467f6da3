"""The sheet of a subject from eight sides."""

import importlib
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from PIL import Image

from splatreel.play.demo_page import SAMPLE
from splatreel.scene.camera import inside, project
from splatreel.scene.gaussians import Gaussians


@pytest.fixture
def turntable(benchmarks: Path) -> ModuleType:
    return importlib.import_module("turntable")


@pytest.mark.parametrize("up", [(0.0, 0.0, 1.0), (0.0, -1.0, 0.0), (0.6, 0.0, 0.8)])
@pytest.mark.parametrize("extent", [(0.3, 0.2, 1.8), (3.0, 1.0, 1.0)])
def test_all_sides_show_the_whole_subject(turntable: ModuleType, up: tuple, extent: tuple) -> None:
    rng = np.random.default_rng(0)
    means = ([5.0, 1.0, -2.0] + rng.uniform(-0.5, 0.5, (2000, 3)) * extent).astype(np.float32)
    means[0] += 100  # floats far away, faintly
    opacities = np.where(np.arange(2000) == 0, 0.1, 0.9).astype(np.float32)
    quats = np.tile(np.array([1, 0, 0, 0], np.float32), (2000, 1))
    points = Gaussians(
        means, quats, np.full((2000, 3), 0.01, np.float32), opacities, np.zeros((2000, 1, 3), np.float32)
    )
    views = turntable.sides(points, np.array(up), 90)
    assert len({tuple(view.center.round(3).tolist()) for view in views}) == 8
    for view in views:
        pixels, depth = project(view, means[1:])
        assert (inside(view, pixels) & (depth > 0)).mean() > 0.98
        assert view.forward @ np.array(up) < 0, "looks down"
        upwards = project(view, np.stack([means[1:].mean(0), means[1:].mean(0) + 0.1 * np.array(up)]))[0]
        assert upwards[1, 1] < upwards[0, 1]


def test_sheet_has_a_row_for_each_frame(turntable: ModuleType, tmp_path: Path) -> None:
    turntable.main(SAMPLE, tmp_path / "sheets" / "sheet.png", frames="0,5", pixels=30)
    sheet = np.asarray(Image.open(tmp_path / "sheets" / "sheet.png"))
    assert sheet.shape == (60, 240, 3)
    assert all(part.std() > 5 for row in np.split(sheet, 2) for part in np.split(row, 8, 1))


def test_frames_of_short_reels_are_drawn_once(turntable: ModuleType) -> None:
    assert [turntable.first_middle_last(count) for count in (1, 2, 6)] == [[0], [0, 1], [0, 3, 5]]
