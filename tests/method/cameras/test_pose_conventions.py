"""Poses stored as camera to world or in other axes, recognized by the images."""

from collections.abc import Callable

import numpy as np
import pytest

from splatreel.capture.pose_checks import inverted, with_opengl_axes
from splatreel.method.cameras.pose_conventions import match_nearest, recognize_convention
from splatreel.method.cameras.poses import PoseFindings, inspect_poses
from splatreel.method.init.features import detect
from splatreel.scene.camera import Camera
from tests.method.corner import arc, make_images

CAMERAS = arc(5)
IMAGES = make_images(CAMERAS)
FEATURES = [detect(image) for image in IMAGES]


def test_correct_poses_keep_their_convention() -> None:
    assert recognize_convention(CAMERAS, FEATURES, match_nearest(CAMERAS, FEATURES)) is None


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
    assert inspect_poses(stored(CAMERAS), np.stack([IMAGES] * 2)) == PoseFindings({}, [], [], [], meant)


def test_unrelated_images_show_no_convention() -> None:
    others = [detect(np.roll(image, (23 * i, 31 * i), (0, 1))) for i, image in enumerate(IMAGES)]
    assert recognize_convention(CAMERAS, others, match_nearest(CAMERAS, others)) is None
