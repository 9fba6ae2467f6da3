"""Pinhole cameras."""

import numpy as np
import pytest

from splatreel.base.errors import CaptureError
from splatreel.scene.camera import Camera, focus_point

K = np.array([[100, 0, 50], [0, 110, 40], [0, 0, 1.0]])


def looking_at(center, target, name="c"):
    """Return a camera at `center` that looks at `target`, with y down as far as possible."""
    forward = np.subtract(target, center) / np.linalg.norm(np.subtract(target, center))
    right = np.cross([0, 1.0, 0.1], forward)
    right /= np.linalg.norm(right)
    viewmat = np.eye(4)
    viewmat[:3, :3] = [right, np.cross(forward, right), forward]
    viewmat[:3, 3] = -viewmat[:3, :3] @ center
    return Camera(name, viewmat, K, 100, 80)


def test_center_and_forward():
    camera = looking_at((1, 2, 3), (1, 2, 8))
    np.testing.assert_allclose(camera.center, [1, 2, 3], atol=1e-5)
    np.testing.assert_allclose(camera.forward, [0, 0, 1], atol=1e-6)


def test_resized_keeps_viewing_rays():
    """A point keeps its relative position in the resized image."""
    camera = looking_at((0, 0, -4), (0, 0, 0))
    small = camera.resized(25, 40)
    point = camera.viewmat[:3, :3] @ (0.3, 0.2, 0.1) + camera.viewmat[:3, 3]
    a, b = camera.K @ point, small.K @ point
    np.testing.assert_allclose(a[:2] / a[2] / (100, 80), b[:2] / b[2] / (25, 40), rtol=1e-5)
    assert (small.width, small.height, camera.width) == (25, 40, 100)


def test_at_most_halves_large_images():
    camera = looking_at((0, 0, -4), (0, 0, 0))
    assert camera.at_most(100) is camera
    assert (camera.at_most(99).width, camera.at_most(99).height) == (50, 40)
    small = camera.at_most(26)
    assert (small.width, small.height) == (25, 20)
    np.testing.assert_allclose(small.K, camera.resized(25, 20).K)


def test_focus_point():
    target = (0.5, -1, 2)
    cameras = [looking_at(center, target) for center in ((4, 0, -3), (-4, 1, -3), (0, 2, -5))]
    np.testing.assert_allclose(focus_point(cameras), target, atol=0.01)


def test_focus_point_of_parallel_cameras_is_finite():
    cameras = [looking_at((x, 0, 0), (x, 0, 1)) for x in (-1.0, 0.0, 1.0)]
    assert np.isfinite(focus_point(cameras)).all()


@pytest.mark.parametrize(
    ("viewmat", "intrinsics", "message"),
    [
        (np.eye(3), K, "'left': viewmat has shape"),
        (np.eye(4), np.eye(4), "'left': K has shape"),
        (np.full((4, 4), np.nan), K, "'left': viewmat holds NaN"),
    ],
)
def test_invalid_cameras_are_refused(viewmat, intrinsics, message):
    with pytest.raises(CaptureError, match=message):
        Camera("left", viewmat, intrinsics, 10, 10)
