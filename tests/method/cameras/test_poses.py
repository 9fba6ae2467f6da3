from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest

from splatreel.capture.pose_checks import inverted, with_opengl_axes
from splatreel.method.cameras.poses import (
    MOVED,
    PLENTY,
    PoseEstimate,
    PoseFindings,
    inspect_poses,
    match_nearest,
    recognize_convention,
)
from splatreel.method.init.triangulate import detect
from splatreel.scene.camera import Camera
from tests.any_threads import assert_same_on_any_threads
from tests.method.corner import HEIGHT, WIDTH, arc, make_images, texture

CAMERAS = arc(9)
TRUTH = make_images(CAMERAS)
ALL_RIGHT = PoseFindings({}, [], [])


def turned(camera: Camera, degrees: float) -> Camera:
    """Return a camera that was turned after its calibration."""
    motion = np.eye(4)
    motion[:3, :3] = cv2.Rodrigues(np.radians(degrees) * np.array([0.8, 0.5, 0.3]))[0]
    return replace(camera, viewmat=motion @ camera.viewmat)


def moments(images: np.ndarray = TRUTH, noise: float = 2.0) -> np.ndarray:
    """Return two noisy copies of the images."""
    noisy = images + np.random.default_rng(0).normal(0, noise, (2, *images.shape))
    return noisy.clip(0, 255).astype(np.uint8)


def apart(a: Camera, b: Camera) -> float:
    """Return the median distance in pixels of what two cameras show of the same places."""
    places = np.stack(np.meshgrid([-2, 0, 2], [-1, 0, 1], [4, 6], indexing="ij"), -1).reshape(-1, 3)
    pixels = []
    for camera in (a, b):
        local = (places @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]) @ camera.K.T
        pixels.append(local[:, :2] / local[:, 2:])
    return float(np.median(np.linalg.norm(pixels[0] - pixels[1], axis=1)))


def test_correct_poses_stay() -> None:
    assert inspect_poses(CAMERAS, moments()) == ALL_RIGHT
    assert inspect_poses(CAMERAS[:3], moments(TRUTH[:3])) == ALL_RIGHT


def test_errors_below_a_pixel_are_ignored() -> None:
    assert inspect_poses([turned(CAMERAS[0], 0.05), *CAMERAS[1:]], moments()) == ALL_RIGHT


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [0.6, 1.0])
def test_moved_cameras_are_corrected(degrees: float) -> None:
    wrong = [turned(camera, degrees) if number in (2, 6) else camera for number, camera in enumerate(CAMERAS)]
    found = inspect_poses(wrong, moments())
    assert set(found.corrected) == {2, 6}
    assert not found.strangers
    assert not found.doubtful
    for number, corrected in found.corrected.items():
        assert apart(wrong[number], CAMERAS[number]) > 1.5
        assert apart(corrected.camera, CAMERAS[number]) < 0.3
        assert corrected.pixels == pytest.approx(apart(wrong[number], CAMERAS[number]), abs=0.5)
        assert corrected.camera.name == CAMERAS[number].name


def test_poses_are_the_same_on_any_threads() -> None:
    cameras, frames = [turned(CAMERAS[0], 0.6), *CAMERAS[1:4]], moments(TRUTH[:4])
    assert_same_on_any_threads(lambda: [*inspect_poses(cameras, frames).corrected.items()])


def test_camera_that_shows_something_else_is_a_stranger() -> None:
    images = TRUTH.copy()
    images[4] = TRUTH[4, ::-1, ::-1]
    found = inspect_poses(CAMERAS, moments(images))
    assert found == PoseFindings({}, [4], [])


def beside(camera: Camera, degrees: float) -> Camera:
    """Return a camera at another place around the scene, five units in front of the others."""
    motion, about = np.eye(4), np.eye(4)
    motion[:3, :3] = cv2.Rodrigues(np.radians(degrees) * np.array([0.0, 1, 0]))[0]
    about[2, 3] = 5
    return replace(camera, viewmat=about @ motion @ np.linalg.inv(about) @ camera.viewmat)


@pytest.mark.slow
def test_isolated_camera_is_kept_unchecked() -> None:
    """It shows the other side, on which there is nothing that its neighbors show: no evidence that it is anywhere else."""
    images = TRUTH.copy()
    images[8] = TRUTH[8, ::-1, ::-1]
    for degrees in (90, 130, 180):
        found = inspect_poses([*CAMERAS[:8], beside(CAMERAS[8], degrees)], moments(images))
        assert found == PoseFindings({}, [], [], [8])


def test_cameras_without_overlap_are_unchecked_not_doubtful() -> None:
    images = np.stack([TRUTH[0], *(texture(seed)[:HEIGHT, :WIDTH].astype(np.uint8) for seed in (8, 9))])
    apart = [CAMERAS[0], beside(CAMERAS[4], 60), beside(CAMERAS[8], -60)]
    assert inspect_poses(apart, moments(images)) == PoseFindings({}, [], [], [0, 1, 2])
    # The same where they stand side by side, and two of three videos are others': too few places to judge by.
    assert inspect_poses([CAMERAS[0], CAMERAS[4], CAMERAS[8]], moments(images)) == PoseFindings({}, [], [], [0, 1, 2])


def test_matching_images_at_wrong_poses_are_doubtful() -> None:
    """Their calibration is wrong: they are said to stand far from each other, and have wide lenses."""
    scale = np.array([[0.6, 1, 1], [1, 0.6, 1], [1, 1, 1]])
    wrong = [beside(replace(c, K=c.K * scale), 70.0 * number) for number, c in enumerate(CAMERAS[:5])]
    assert inspect_poses(wrong, moments(TRUTH[:5])) == PoseFindings({}, [], [0, 1, 2, 3, 4])


def test_too_many_wrong_poses_are_all_doubtful() -> None:
    wrong = [
        turned(camera, 1.0 if number % 2 else -1.0) if number % 3 == 1 else camera
        for number, camera in enumerate(CAMERAS)
    ]
    found = inspect_poses(wrong, moments())
    assert not found.corrected
    assert not found.strangers
    assert set(found.doubtful) >= {1, 4, 7}


def test_moving_thing_is_not_mistaken_for_a_moved_camera() -> None:
    """Half of the images are elsewhere in the first moment, as they are of cameras that are out of step."""
    frames = moments()
    frames[0, 3, :, : WIDTH // 2] = np.roll(frames[0, 3], 4, axis=1)[:, : WIDTH // 2]
    assert inspect_poses(CAMERAS, frames) == ALL_RIGHT


def test_images_without_features_change_nothing() -> None:
    found = inspect_poses(CAMERAS, np.full((2, 9, 64, WIDTH, 3), 90, np.uint8))
    assert found == PoseFindings({}, [], [], list(range(9)))


def test_fewer_features_need_a_larger_error():
    """A dancer before plain walls has few, and her outlines are elsewhere for each camera."""
    few, off = PLENTY // 4, 2 * MOVED
    assert PoseEstimate(CAMERAS[0], gain=2, moved=off, features=PLENTY).wrong
    assert not PoseEstimate(CAMERAS[0], gain=2, moved=off, features=few).wrong
    assert PoseEstimate(CAMERAS[0], gain=2, moved=5 * MOVED, features=few).wrong
    assert not PoseEstimate(CAMERAS[0], gain=1, moved=5 * MOVED, features=PLENTY).wrong


POSED = arc(5)
IMAGES = make_images(POSED)
FEATURES = [detect(image) for image in IMAGES]


def test_correct_poses_keep_their_convention() -> None:
    assert recognize_convention(POSED, FEATURES, match_nearest(POSED, FEATURES)) is None


@pytest.mark.parametrize(
    ("stored", "meant"),
    [
        (inverted, "camera to world"),
        (with_opengl_axes, "world to camera in OpenGL's axes (y up, z backwards)"),
        (lambda cameras: inverted(with_opengl_axes(cameras)), "camera to world in OpenGL's axes (y up, z backwards)"),
    ],
)
def test_convention_of_the_poses_is_recognized(stored: Callable[[list[Camera]], list[Camera]], meant: str) -> None:
    """The cameras stand in a row and look ahead. The axes of their inverse poses meet in front of the cameras, too."""
    assert inspect_poses(stored(POSED), np.stack([IMAGES] * 2)) == PoseFindings({}, [], [], [], meant)


def test_unrelated_images_show_no_convention() -> None:
    others = [detect(np.roll(image, (23 * i, 31 * i), (0, 1))) for i, image in enumerate(IMAGES)]
    assert recognize_convention(POSED, others, match_nearest(POSED, others)) is None
