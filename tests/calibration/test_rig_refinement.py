"""Refinement of a rough rig by the points of several moments."""

from pathlib import Path

import numpy as np
import pytest

from splatreel.calibration.rig_refinement import refine_by_moments, refine_lenses
from tests.capture.rigs import disturb, images, rig, rotations, turned


def test_points_of_all_moments_make_poses_more_exact(tmp_path: Path) -> None:
    colmap = pytest.importorskip("pycolmap")
    (tmp_path / "images").mkdir()
    moments = [rig(colmap, 0.5, seed) for seed in range(5)]
    known = rotations(moments[0])
    for moment in moments:
        disturb(colmap, moment)
        refine_lenses(colmap, moment)
    before = [turned(moment, known) for moment in moments]
    refined = refine_by_moments(colmap, moments[0], moments, tmp_path)
    assert turned(refined, known) < 0.7 * np.median(before)
    assert min(image.num_points3D for image in images(refined)) > 150


def test_lenses_are_refined_with_their_middle() -> None:
    colmap = pytest.importorskip("pycolmap")
    model = rig(colmap)
    known = rotations(model)
    disturb(colmap, model)
    refine_lenses(colmap, model)
    assert turned(model, known) < 0.05
    for image in images(model):
        assert image.camera.params[1:3] == pytest.approx([326, 235], abs=0.5)


def test_the_middle_stays_where_points_do_not_tell_it() -> None:
    colmap = pytest.importorskip("pycolmap")
    model = rig(colmap, noise=1.0, spread=0.4)
    disturb(colmap, model)
    refine_lenses(colmap, model)
    for image in images(model):
        assert image.camera.params[1:3] == pytest.approx([320, 240])
