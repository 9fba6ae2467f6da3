"""Refinement of a rough rig by matches of known points, many of them wrong."""

from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from splatreel.capture import dense_matches
from splatreel.capture.dense_matches import refine_by_matches, refine_by_moments, refine_lenses
from splatreel.capture.learned_matches import Features
from splatreel.progress import Silent

MOMENTS, POINTS = 2, 500
SPREAD = 2.0
"""Half the side of the cube of points, 5 units away; they fill most of each picture."""


def rig(colmap: Any, noise: float = 0.0, seed: int = 0) -> Any:
    """Return eight cameras around points whose lenses have their middle off the picture's.

    Args:
        colmap: Module pycolmap.
        noise: Standard deviation of the places of its few points in the pictures, in pixels.
        seed: Seed of the noise and the points; the cameras are always the same.
    """
    colmap.set_random_seed(seed)
    options, rng = colmap.SyntheticDatasetOptions(), np.random.default_rng(2)
    options.num_rigs, options.num_frames_per_rig, options.num_points3D = 8, 1, 60
    options.camera_width, options.camera_height = 640, 480
    options.camera_params, options.num_points2D_without_point3D = [380, 326, 235, -0.1], 0
    made = colmap.synthesize_dataset(options)
    other = np.random.default_rng((2, seed))
    for point, place in zip(made.points3D.values(), rng.uniform(-SPREAD, SPREAD, (60, 3)), strict=True):
        point.xyz = place if seed == 0 else other.uniform(-SPREAD, SPREAD, 3)
    for number, image in enumerate(images(made)):
        angles = [22 * number, [-25, 5, 30][number % 3], 50 * number]  # a level ring would leave the lens's middle open
        turn = Rotation.from_euler("yxz", angles, degrees=True).as_matrix().T
        place = [*rng.uniform(-1, 1, 2), rng.uniform(3.5, 6.5)]  # nor would cameras that all look at one point tell it
        pose = colmap.Rigid3d(colmap.Rotation3d(turn), np.array(place))
        made.frame(image.frame_id).set_cam_from_world(image.camera_id, pose)
        for point in image.points2D:
            place = image.camera.img_from_cam(image.cam_from_world() * made.point3D(point.point3D_id).xyz)
            point.xy = place + other.normal(0, noise, 2)
    return made


def images(model: Any) -> list[Any]:
    return sorted((model.image(number) for number in model.reg_image_ids()), key=lambda image: image.name)


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


def disturb(colmap: Any, model: Any) -> None:
    """Turn each camera by about a degree, and put the middle of its lens into the middle of the picture."""
    rng = np.random.default_rng(1)
    for image in images(model):
        pose = image.cam_from_world()
        turn = Rotation.from_rotvec(rng.normal(0, 0.006, 3)).as_matrix() @ pose.rotation.matrix()
        model.frame(image.frame_id).set_cam_from_world(
            image.camera_id, colmap.Rigid3d(colmap.Rotation3d(turn), pose.translation)
        )
        image.camera.params = [605, 320, 240, 0]


def rotations(model: Any) -> list[np.ndarray]:
    return [image.cam_from_world().rotation.matrix() for image in images(model)]


def turned(model: Any, known: list[np.ndarray]) -> float:
    """Return the median error of the rotations between cameras, in degrees."""
    found = rotations(model)
    errors = [
        Rotation.from_matrix((found[a] @ found[b].T) @ (known[a] @ known[b].T).T).magnitude()
        for a, b in combinations(range(len(found)), 2)
    ]
    return float(np.degrees(np.median(errors)))


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


def test_the_middle_stays_where_points_do_not_tell_it(monkeypatch: pytest.MonkeyPatch) -> None:
    colmap = pytest.importorskip("pycolmap")
    monkeypatch.setattr("tests.capture.test_dense_matches.SPREAD", 0.4)
    model = rig(colmap, noise=1.0)
    disturb(colmap, model)
    refine_lenses(colmap, model)
    for image in images(model):
        assert image.camera.params[1:3] == pytest.approx([320, 240])
