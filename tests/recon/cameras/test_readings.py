"""Poses that were stored the other way round, or in other axes: the pictures tell, also where the rig alone does not."""

from collections.abc import Callable

import numpy as np
import pytest

from splatreel.capture.pose_checks import inverted, with_opengl_axes
from splatreel.recon.cameras.findings import Findings
from splatreel.recon.cameras.poses import check_poses
from splatreel.recon.cameras.readings import match_nearest, misread
from splatreel.recon.init.features import detect
from splatreel.scene.camera import Camera
from tests.recon.corner import arc, pictures

CAMERAS = arc(5)
PICTURES = pictures(CAMERAS)
FEATURES = [detect(picture) for picture in PICTURES]


def test_poses_that_are_right_are_read_as_they_are() -> None:
    assert misread(CAMERAS, FEATURES, match_nearest(CAMERAS, FEATURES)) is None


@pytest.mark.parametrize(
    ("stored", "meant"),
    [
        (inverted, "camera to world"),
        (with_opengl_axes, "world to camera in OpenGL's axes (y up, z backwards)"),
        (lambda cameras: inverted(with_opengl_axes(cameras)), "camera to world in OpenGL's axes (y up, z backwards)"),
    ],
)
def test_what_is_stored_is_told(stored: Callable[[list[Camera]], list[Camera]], meant: str) -> None:
    """Of a row of cameras that look ahead: the axes of its inverse meet before the cameras as well."""
    assert check_poses(stored(CAMERAS), np.stack([PICTURES] * 2)) == Findings({}, [], [], [], meant)


def test_pictures_of_other_things_tell_nothing() -> None:
    others = [detect(np.roll(picture, (23 * i, 31 * i), (0, 1))) for i, picture in enumerate(PICTURES)]
    assert misread(CAMERAS, others, match_nearest(CAMERAS, others)) is None
