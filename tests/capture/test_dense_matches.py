"""Refinement of a rough rig by matches of known points, many of them wrong."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from splatreel.capture import dense_matches
from splatreel.capture.dense_matches import refine_by_matches, refine_by_moments, refine_lenses
from splatreel.capture.learned_matches import Features
from splatreel.progress import Silent
from tests.capture.rigs import SPREAD, disturb, images, rig, rotations, turned

MOMENTS, POINTS = 2, 500


def features(model: Any) -> dict[str, list[Features]]:
    """Return the views of random points at each moment. A third of the descriptors are those of other points."""
    rng, found = np.random.default_rng(0), {}
    space = rng.uniform(-SPREAD, SPREAD, (MOMENTS, POINTS, 3))
    names = rng.normal(size=(MOMENTS, POINTS, 32))
    names /= np.linalg.norm(names, axis=2, keepdims=True)
    for image in images(model):
        moments = []
        for points, labels in zip(space, names, strict=True):
            places = np.array([image.camera.img_from_cam(image.cam_from_world() * point) for point in points])
            wrong = rng.random(POINTS) < 0.33
            shuffled = labels.copy()
            shuffled[wrong] = rng.permutation(labels[wrong])
            places += rng.normal(0, 0.2, places.shape)
            moments.append(Features(places.astype(np.float32), shuffled.astype(np.float32), (640, 480)))
        found[Path(image.name).stem] = moments
    return found


@pytest.fixture
def few_rough_matches(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take the points of the rig for too few to place its cameras exactly."""
    monkeypatch.setattr(dense_matches, "ENOUGH", 1000)


@pytest.mark.usefixtures("few_rough_matches")
def test_matches_make_poses_more_exact(tmp_path: Path) -> None:
    colmap = pytest.importorskip("pycolmap")
    (tmp_path / "images").mkdir()
    model = rig(colmap, noise=1.5)
    known, found = rotations(model), features(model)
    refine_lenses(colmap, model)
    before = turned(model, known)
    refined = refine_by_matches(colmap, model, found, tmp_path, Silent())
    assert turned(refined, known) < 0.6 * before
    assert [image.name for image in images(refined)] == [image.name for image in images(model)]
    assert min(image.num_points3D for image in images(refined)) > 300


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


def test_cameras_with_many_rough_matches_get_no_others(tmp_path: Path) -> None:
    """The rough matches are the more exact ones."""
    colmap = pytest.importorskip("pycolmap")
    rough = rig(colmap, 1.0)
    assert refine_by_matches(colmap, rough, features(rig(colmap)), tmp_path, Silent()) is rough


@pytest.mark.usefixtures("few_rough_matches")
def test_cameras_without_matches_stay(tmp_path: Path) -> None:
    """The points of the rough model hold a camera whose pictures have no learned features."""
    colmap = pytest.importorskip("pycolmap")
    (tmp_path / "images").mkdir()
    model = rig(colmap)
    known, found, blind = rotations(model), features(model), Path(images(model)[3].name).stem
    nothing = Features(np.zeros((0, 2), np.float32), np.zeros((0, 32), np.float32), (640, 480))
    found[blind] = [nothing] * MOMENTS
    refined = refine_by_matches(colmap, model, found, tmp_path, Silent())
    assert turned(refined, known) < 0.3
    assert images(refined)[3].num_points3D >= 30


@pytest.mark.usefixtures("few_rough_matches")
def test_matches_that_contradict_the_model_are_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    colmap = pytest.importorskip("pycolmap")

    def lose_points(colmap: Any, model: Any, *_: Any) -> Any:
        copy = colmap.Reconstruction(model)
        for point in sorted(copy.points3D)[20:]:
            copy.delete_point3D(point)
        return copy

    monkeypatch.setattr("splatreel.capture.dense_matches._triangulate", lose_points)
    model = rig(colmap)
    assert refine_by_matches(colmap, model, features(model), tmp_path, Silent()) is model


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
