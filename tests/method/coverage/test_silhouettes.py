"""Poses that are right or wrong, told from the masks of a ball before a ring of cameras."""

from dataclasses import replace

import numpy as np
import pytest

from splatreel.method.coverage.silhouettes import mask_fits
from splatreel.scene.camera import Camera
from splatreel.scene.projection import unproject
from tests.method.scenes import ring

CAMERAS = ring(5, width=80, height=60)
MIDDLE, RADIUS = np.array([0.2, 0.1, -0.1]), 0.4


def ball(camera: Camera) -> np.ndarray:
    """Return the mask [H, W] uint8 of a ball."""
    rays = unproject(camera, np.ones((camera.height, camera.width))) - camera.center
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    to_middle = MIDDLE - camera.center
    beside = to_middle - (rays @ to_middle)[..., None] * rays
    return np.where(np.linalg.norm(beside, axis=-1) < RADIUS, 255, 0).astype(np.uint8)


MASKS = np.stack([ball(camera) for camera in CAMERAS])


def turned(camera: Camera, degrees: float) -> Camera:
    """Return a camera whose pose is wrong by an angle."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turn = np.array([[c, 0, -s, 0], [0, 1, 0, 0], [s, 0, c, 0], [0, 0, 0, 1]])
    return replace(camera, viewmat=turn @ camera.viewmat)


def test_masks_of_right_poses_fit() -> None:
    assert mask_fits(CAMERAS, MASKS, MIDDLE, 0.1) == [1.0] * 5


@pytest.mark.parametrize("degrees", [10, -10, 25])
def test_a_wrong_pose_does_not_fit(degrees: float) -> None:
    cameras = [turned(CAMERAS[0], degrees), *CAMERAS[1:]]
    assert min(mask_fits(cameras, MASKS, MIDDLE, 0.1)) < 0.8


def test_masks_that_hardly_show_the_subject_confirm_nothing() -> None:
    """Masks without weights leave out what no other camera confirms: with a wrong pose, almost everything."""
    some = MASKS.copy()
    some[2, : np.nonzero(MASKS[2].any(1))[0][-1]] = 0
    assert some[2].any()
    assert mask_fits(CAMERAS, some, MIDDLE, 0.1)[2] == 0
    some[2] = 0
    assert mask_fits(CAMERAS, some, MIDDLE, 0.1)[2] == 0


def test_two_masks_confirm_nothing() -> None:
    assert mask_fits(CAMERAS[:2], MASKS[:2], MIDDLE, 0.1) == [0, 0]
    assert mask_fits(CAMERAS[:3], MASKS[:3], MIDDLE, 0.1) == [1, 1, 1]
