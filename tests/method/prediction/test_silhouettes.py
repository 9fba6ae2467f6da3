"""Poses that are right or wrong, told from the masks of balls before a ring of cameras."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from splatreel.method.prediction.silhouettes import Silhouettes
from splatreel.scene.camera import Camera, unproject
from tests.segmentation.scenes import ring

CAMERAS = ring(5)
MIDDLE = np.array([0.2, 0.7, -0.1])
BODY = ((MIDDLE, 0.4), (MIDDLE + np.array([0.1, 0.55, 0.2]), 0.2), (MIDDLE + np.array([-0.5, -0.2, 0.1]), 0.15))
"""Middles and radii of the balls of a body without symmetry."""


def draw(camera: Camera, balls: Sequence[tuple[np.ndarray, float]]) -> np.ndarray:
    """Return the mask [H, W] uint8 of balls."""
    rays = unproject(camera, np.ones((camera.height, camera.width))) - camera.center
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    mask = np.zeros(rays.shape[:2], bool)
    for middle, radius in balls:
        to_middle = middle - camera.center
        beside = to_middle - (rays @ to_middle)[..., None] * rays
        mask |= np.linalg.norm(beside, axis=-1) < radius
    return np.where(mask, 255, 0).astype(np.uint8)


def moment(x: float = 0, z: float = 0) -> np.ndarray:
    """Return the masks [C, H, W] of the body at a place."""
    return np.stack(
        [draw(camera, [(place + np.array([x, 0, z]), radius) for place, radius in BODY]) for camera in CAMERAS]
    )


MASKS = np.stack([moment(), moment(0.5, -0.4)])


def turned(camera: Camera, degrees: float) -> Camera:
    """Return a camera whose pose is wrong by an angle."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turn = np.array([[c, 0, -s, 0], [0, 1, 0, 0], [s, 0, c, 0], [0, 0, 0, 1]])
    return replace(camera, viewmat=turn @ camera.viewmat)


def fits(cameras: list[Camera], masks: np.ndarray) -> list[float]:
    return Silhouettes(cameras, masks, MIDDLE, 0.1).fits


def doubt(cameras: list[Camera], masks: np.ndarray) -> str | None:
    """Return wrong poses that fit as well; None where the given ones do not fit."""
    found = Silhouettes(cameras, masks, MIDDLE, 0.1)
    return found.wrong_poses_that_fit() if min(found.fits) >= 0.9 else None


def test_masks_of_right_poses_fit_and_would_not_fit_wrong_ones() -> None:
    assert min(fits(CAMERAS, MASKS)) > 0.98
    assert doubt(CAMERAS, MASKS) == ""


@pytest.mark.parametrize("degrees", [10, -10, 25])
def test_a_wrong_pose_does_not_fit(degrees: float) -> None:
    cameras = [turned(CAMERAS[0], degrees), *CAMERAS[1:]]
    assert min(fits(cameras, MASKS)) < 0.8


@pytest.mark.parametrize("degrees", [5, -5, 10, -10, 30])
@pytest.mark.parametrize("wrong", [0, 3])
def test_a_wrong_pose_is_not_confirmed(wrong: int, degrees: float) -> None:
    cameras = [turned(camera, degrees) if c == wrong else camera for c, camera in enumerate(CAMERAS)]
    assert doubt(cameras, MASKS) != ""


@pytest.mark.parametrize("pair", [(0, 1), (0, 2), (1, 4)])
def test_exchanged_cameras_are_not_confirmed(pair: tuple[int, int]) -> None:
    order = list(range(5))
    order[pair[0]], order[pair[1]] = pair[1], pair[0]
    assert doubt(CAMERAS, MASKS[:, order]) != ""


@pytest.mark.parametrize("share", [-0.3, 0.3])
def test_a_camera_at_a_wrong_place_is_not_confirmed(share: float) -> None:
    viewmat = CAMERAS[1].viewmat.copy()
    viewmat[[0, 2], 3] += share * viewmat[2, 3] * np.array([0.4, 1])
    assert doubt([CAMERAS[0], replace(CAMERAS[1], viewmat=viewmat), *CAMERAS[2:]], MASKS) != ""


def boxes(masks: np.ndarray, margin: int) -> np.ndarray:
    """Return a box around each mask [M, C, H, W]."""
    out = np.zeros_like(masks)
    for target, mask in zip(out.reshape(-1, *masks.shape[2:]), masks.reshape(-1, *masks.shape[2:]), strict=True):
        rows, columns = np.nonzero(mask)
        top, left = max(rows.min() - margin, 0), max(columns.min() - margin, 0)
        target[top : rows.max() + 1 + margin, left : columns.max() + 1 + margin] = 255
    return out


@pytest.mark.parametrize("masks", [np.full_like(MASKS, 255), boxes(MASKS, 16)], ids=["white", "boxes"])
def test_large_masks_confirm_nothing(masks: np.ndarray) -> None:
    assert min(fits(CAMERAS, masks)) > 0.9, "they fit"
    assert "as well if " in (doubt(CAMERAS, masks) or "")
    turned_away = [turned(CAMERAS[0], 10), *CAMERAS[1:]]
    assert doubt(turned_away, masks) != ""


def test_a_ball_in_the_middle_does_not_tell_cameras_apart() -> None:
    masks = np.stack([[draw(camera, [(np.array([0, 0.6, 0]), 0.5)]) for camera in CAMERAS]])
    assert "were exchanged" in (doubt(CAMERAS, masks) or "")


def test_masks_of_another_moment_do_not_fit() -> None:
    masks = MASKS.copy()
    masks[:, 2] = MASKS[::-1, 2]
    assert doubt(CAMERAS, masks) is None


def test_masks_that_hardly_show_the_subject_confirm_nothing() -> None:
    """Masks without weights leave out what no other camera confirms: with a wrong pose, almost everything."""
    some = MASKS[:1].copy()
    some[0, 2, : np.nonzero(some[0, 2].any(1))[0][-1]] = 0
    assert some[0, 2].any()
    assert fits(CAMERAS, some)[2] == 0
    some[0, 2] = 0
    assert fits(CAMERAS, some)[2] == 0


def test_moments_at_which_a_camera_does_not_see_the_subject_do_not_count() -> None:
    some = np.concatenate([MASKS, MASKS[:1]])
    some[2] = 0
    some[1, 2] = 0
    assert fits(CAMERAS, some)[2] > 0.98


def test_two_masks_confirm_nothing() -> None:
    assert fits(CAMERAS[:2], MASKS[:, :2]) == [0, 0]
    assert min(fits(CAMERAS[:3], MASKS[:, :3])) > 0.98
