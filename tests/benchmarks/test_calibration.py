"""The errors of a calibration against known cameras."""

import importlib
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from splatreel.scene.camera import Camera
from tests.capture import folders


@pytest.fixture
def calibration(benchmarks: Path) -> ModuleType:
    return importlib.import_module("calibration")


def moved(cameras: list[Camera]) -> list[Camera]:
    """Return the cameras in a rotated, scaled and translated world."""
    turn = Rotation.from_rotvec([0.3, -0.7, 1.1]).as_matrix()
    found = []
    for camera in cameras:
        viewmat = np.eye(4)
        viewmat[:3, :3] = camera.viewmat[:3, :3] @ turn.T
        viewmat[:3, 3] = -viewmat[:3, :3] @ (3 * turn @ camera.center + [1, 2, 3])
        found.append(Camera(camera.name, viewmat, camera.K, camera.width, camera.height))
    return found


def test_the_world_of_a_calibration_does_not_count(calibration: ModuleType) -> None:
    known = folders.cameras(6)
    errors = calibration.align(moved(known), known)
    assert errors["rotation_degrees"].max() < 0.05
    assert errors["by_centers_degrees"].max() < 0.05
    assert errors["position_percent"].max() < 0.1


def test_a_turned_camera_counts(calibration: ModuleType) -> None:
    known = folders.cameras(6)
    found = moved(known)
    found[2] = turned(found[2])
    errors = calibration.align(found, known)
    assert errors["by_centers_degrees"][2] == pytest.approx(2, abs=0.05)
    assert np.delete(errors["by_centers_degrees"], 2).max() < 0.05
    assert errors["rotation_degrees"][2] == pytest.approx(2 * 5 / 6, abs=0.05)
    assert np.delete(errors["rotation_degrees"], 2).max() == pytest.approx(2 / 6, abs=0.05)
    assert errors["position_percent"].max() < 0.1


def test_a_rotation_of_all_cameras_counts_only_against_their_centers(calibration: ModuleType) -> None:
    known = folders.cameras(6)
    errors = calibration.align([turned(camera) for camera in moved(known)], known)
    assert errors["by_centers_degrees"].min() == pytest.approx(2, abs=0.05)
    assert errors["rotation_degrees"].max() < 1
    assert errors["position_percent"].max() < 0.1


def turned(camera: Camera) -> Camera:
    """Return a camera turned by two degrees about its own center."""
    viewmat = camera.viewmat.copy()
    viewmat[:3] = Rotation.from_rotvec([0, np.radians(2), 0]).as_matrix() @ viewmat[:3]
    return Camera(camera.name, viewmat, camera.K, camera.width, camera.height)


def test_thinned_rigs_are_spread(calibration: ModuleType) -> None:
    cameras = folders.cameras(7)
    names = [camera.name for camera in calibration.thin(cameras, 3)]
    assert {"cam00", "cam06"} <= set(names)
    assert calibration.thin(cameras, 31) == cameras
