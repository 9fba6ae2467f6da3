"""Sentences about the shares of the images that masks cover."""

import numpy as np

from splatreel.capture.mask_shares import describe_motion, describe_shares, describe_sizes, mask_shares
from splatreel.scene.camera import Camera, facing
from tests.segmentation import scenes

NAMES = ["a", "b", "c"]


def described(**columns: list[float]) -> list[str]:
    """Return the sentences after the first one, for cameras whose other frames have plausible shares."""
    shares = np.tile([0.08, 0.1, 0.12], (8, 1))
    for name, values in columns.items():
        shares[:, NAMES.index(name)] = values
    return describe_shares(NAMES, shares, first=10)[1:]


def test_share_of_each_camera_is_said() -> None:
    shares = np.array([[0.08, 0.1, 0.5], [0.1, 0.1, np.nan]])
    assert describe_shares(NAMES, shares)[0] == "the masks cover, of the images of a 9.0%, b 10.0%, c 50.0%"
    assert described() == []
    masks = np.zeros((2, 3, 4, 5), np.uint8)
    masks[1, 2, 0, 0] = 255
    np.testing.assert_allclose(mask_shares(masks), [[0, 0, 0], [0, 0, 0.05]])


def test_implausible_shares_are_named() -> None:
    assert described(b=[0.0] * 8) == ["the masks of b are black: no subject is seen there"]
    [said] = described(b=[1.0] * 8, c=[0.7] * 8)
    assert said.startswith("the masks of b, c cover most of the image")
    assert "inverted" in said


def test_frames_that_differ_are_named() -> None:
    [said] = described(a=[0.08, 0, 0, 0, 0.08, 0, 0.08, 0.08])
    assert said == "the masks of a are empty in frames 11 to 13, 15, 8.0% are usual"
    [said] = described(c=[0.12] * 5 + [0.6] * 3)
    assert said.startswith("the masks of c cover up to 60% of the image in frames 15 to 17, 12.0% are usual")
    [said] = described(a=[0.02] * 4 + [0.1] * 4)
    assert said == "the masks of a change abruptly at frame 14, from 2.0% to 10.0% of the image"


def test_people_who_come_closer_and_leave_are_not_named() -> None:
    assert described(a=[0, 0.005, 0.01, 0.015, 0.03, 0.05, 0.08, 0.12]) == []
    assert described(a=[0.02, 0.03, 0.05, 0.08, 0.1, 0.13, 0.16, 0.2]) == []


def body(cameras: list[Camera]) -> np.ndarray:
    """Return the masks [1, C, H, W] uint8 of the body of the scenes."""
    return np.stack(
        [np.where(scenes.shoot(view, c, 3)[1], np.uint8(255), np.uint8(0)) for c, view in enumerate(cameras)]
    )[None]


def test_sizes_that_distances_explain_are_not_named() -> None:
    cameras = scenes.ring()
    near = cameras[2].center * [0.45, 1, 0.45]
    forward = np.array([0, 0.6, 0]) - near
    cameras[2] = facing(
        "near", near, forward / np.linalg.norm(forward), 0.8 * scenes.WIDTH, scenes.WIDTH, scenes.HEIGHT
    )
    masks = body(cameras)
    shares = mask_shares(masks[0])
    assert shares[2] > 4 * np.median(shares)
    assert describe_sizes(cameras, masks) == []


def test_sizes_that_distances_do_not_explain_are_named() -> None:
    cameras = scenes.ring()
    masks = body(cameras)
    masks[0, 1, 5:-5, 5:-5] = 255
    masks[0, 4, :30] = 0
    masks[0, 4, :, :46] = 0
    [said] = describe_sizes(cameras, masks)
    assert "c1 (" in said
    assert "times larger)" in said
    assert describe_sizes(cameras[:2], masks[:, :2]) == []
    assert describe_sizes(cameras, np.zeros_like(masks)) == []


def test_masks_without_what_moves_are_named() -> None:
    """Masks of another capture and shifted ones may fit each other."""
    images, shown = scenes.film(9)
    images, masks = images[[0, 8]], np.where(shown[[0, 8]], 255, 0).astype(np.uint8)
    assert describe_motion(NAMES6, images, masks) == []
    assert describe_motion(NAMES6, images[[0, 0]], masks[[0, 0]]) == [], "nothing moves"
    shifted = np.roll(masks, scenes.WIDTH // 5, -1)
    head = masks.copy()
    for mask in head.reshape(-1, *masks.shape[2:]):
        mask[np.flatnonzero(mask.any(1))[0] + 4 :] = 0
    for wrong in (shifted, head):
        [said] = describe_motion(NAMES6, images, wrong)
        assert "c0 (" in said
        assert "are they shifted, of another capture, or of a part of the subject" in said
    shifted[:, 1:] = masks[:, 1:]
    assert "in c0 (" in describe_motion(NAMES6, images, shifted)[0]


NAMES6 = [camera.name for camera in scenes.ring()]
