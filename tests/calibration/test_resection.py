"""Placement of a camera that a rig lacks, from matches many of which are wrong."""

from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from splatreel.calibration.calibration_agreement import CalibratedCamera, rig_of
from splatreel.calibration.resection import MatchedFeatures, place_lost
from tests.capture.rigs import images, rig

FEW = 20
LOST = 3
"""Number of the camera that the rig lacks."""


def views(model: Any) -> list[np.ndarray]:
    """Return where each camera sees the points, in the order of their numbers."""
    return [
        np.array([point.xy for point in sorted(image.points2D, key=lambda point: point.point3D_id)])
        for image in images(model)
    ]


def write_matches(colmap: Any, model: Any, pixels: list[np.ndarray], database: Path) -> MatchedFeatures:
    """Write the features of all cameras, where equal rows of any two match, and read them."""
    with colmap.Database.open(database) as file:
        numbers = []
        for image, places in zip(images(model), pixels, strict=True):
            lens = colmap.Camera(model="SIMPLE_RADIAL", width=640, height=480, params=[640, 320, 240, 0])
            numbers.append(file.write_image(colmap.Image(name=image.name, camera_id=file.write_camera(lens))))
            file.write_keypoints(numbers[-1], places.astype(np.float32))
        rows = np.arange(len(pixels[0]), dtype=np.uint32)
        for one, other in combinations(numbers, 2):
            file.write_matches(one, other, np.stack([rows, rows], 1))
    return MatchedFeatures(colmap, [database])


def lose(model: Any) -> str:
    """Take a camera out of a model, and return its name."""
    image = images(model)[LOST]
    name = Path(image.name).stem
    model.deregister_frame(image.frame_id)
    model.tear_down()
    return name


def error(found: CalibratedCamera, known: CalibratedCamera) -> tuple[float, float]:
    """Return the difference of two poses in degrees and in units of the world."""
    turn = Rotation.from_matrix(found.rotation @ known.rotation.T).magnitude()
    return float(np.degrees(turn)), float(np.linalg.norm(found.center - known.center))


@pytest.mark.parametrize("lenses", [8, 1])
def test_a_lost_camera_is_placed(tmp_path: Path, lenses: int) -> None:
    """Half of its matches are wrong."""
    colmap = pytest.importorskip("pycolmap")
    model = rig(colmap, noise=0.3, lenses=lenses)
    known, pixels = rig_of(model), views(model)
    pixels[LOST][::2] = np.random.default_rng(0).uniform(0, 480, pixels[LOST][::2].shape)
    features = write_matches(colmap, model, pixels, tmp_path / "moment.db")
    name = lose(model)
    added = place_lost(colmap, model, [], features, FEW)
    assert list(added) == [name]
    assert 25 <= added[name] <= 36
    found = rig_of(model)
    assert np.all(np.array(error(found[name], known[name])) < [2, 0.3])  # its lens gets its middle by later refinement
    assert (found[name].points, len(found)) == (added[name], 8)
    assert len(model.cameras) == lenses


def test_a_camera_that_may_be_elsewhere_is_not_placed(tmp_path: Path) -> None:
    """Unless a moment placed it there too."""
    colmap = pytest.importorskip("pycolmap")
    model = rig(colmap, noise=0.3)
    known, pixels = rig_of(model), views(model)
    pixels[LOST][:25] = pixels[LOST - 2][:25]
    features = write_matches(colmap, model, pixels, tmp_path / "moment.db")
    name = lose(model)
    assert place_lost(colmap, model, [], features, FEW) == {}
    others = {other: placed for other, placed in known.items() if other != name}
    assert place_lost(colmap, model, [others | {name: known[sorted(known)[0]]}], features, FEW) == {}
    assert set(rig_of(model)) == set(others)
    assert list(place_lost(colmap, model, [known], features, FEW)) == [name]
    assert error(rig_of(model)[name], known[name])[0] < 2


def test_a_camera_with_few_points_is_not_placed(tmp_path: Path) -> None:
    colmap = pytest.importorskip("pycolmap")
    model = rig(colmap)
    pixels = views(model)
    pixels[LOST][FEW - 1 :] = np.random.default_rng(0).uniform(0, 480, pixels[LOST][FEW - 1 :].shape)
    features = write_matches(colmap, model, pixels, tmp_path / "moment.db")
    lose(model)
    assert place_lost(colmap, model, [], features, FEW + 3) == {}
