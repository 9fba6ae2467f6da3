"""Invalid poses, inverted poses and poses with other axes are detected; correct rigs give no doubts."""

from dataclasses import replace

import numpy as np
import pytest

from splatreel.base.errors import CaptureError
from splatreel.capture.pose_checks import inverted, validate_poses, with_opengl_axes
from splatreel.scene.camera import Camera
from tests.capture import folders
from tests.method.corner import arc
from tests.method.scenes import ring
from toyroom.capture import make_cameras

POINTS = np.random.default_rng(0).uniform(-0.5, 0.5, (40, 3)).astype(np.float32)
RIGS = {
    "built-in": make_cameras(64, 48),
    "ring": ring(6, width=48, height=32),
    "folders": folders.cameras(),
    "arc": arc(5),
}


def changed(cameras: list[Camera], change: np.ndarray) -> list[Camera]:
    """Return cameras with the second one multiplied from the left by a matrix."""
    return [replace(c, viewmat=change @ c.viewmat) if i == 1 else c for i, c in enumerate(cameras)]


@pytest.mark.parametrize("rig", RIGS)
def test_correct_rigs_give_no_doubts(rig: str) -> None:
    assert validate_poses(RIGS[rig], None, "poses.txt") == []


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            np.diag([1.0, 1, -1, 1]),
            r"poses.txt: camera 'cam01': the 3x3 part of its pose is \[\[.*it mirrors .*determinant is -1",
        ),
        (np.diag([2.0, 2, 2, 1]), r"2, 2, 2 long.*Divide its 3x3 part by 2\."),
        (np.diag([1.0, 1.1, 1, 1]), r"1, 1.1, 1 long.*Export the poses again\."),
        (np.diag([1.0, 1, 1, 2]), r"the last row of the pose is \[0\.0, 0\.0, 0\.0, 2\.0\]"),
    ],
)
def test_invalid_pose_matrices_are_refused(change: np.ndarray, message: str) -> None:
    with pytest.raises(CaptureError, match=message):
        validate_poses(changed(folders.cameras(), change), None, "poses.txt")


@pytest.mark.parametrize("K", [np.zeros((3, 3)), np.diag([-40.0, 40, 1]), [[40, 9, 16], [0, 40, 12], [0, 0, 1]]])
def test_invalid_intrinsics_are_refused(K: np.ndarray) -> None:
    with pytest.raises(CaptureError, match=r"camera 'cam00': K is .* expected fx, 0, cx"):
        validate_poses([replace(folders.cameras()[0], K=K), *folders.cameras()[1:]], None, "poses.txt")


def test_points_behind_cameras_are_refused() -> None:
    cameras = RIGS["ring"]
    assert validate_poses(cameras, POINTS, "sparse/0") == []
    with pytest.raises(CaptureError, match=r"sparse/0: the poses do not fit the capture's points: .* 100% behind it\."):
        validate_poses(with_opengl_axes(cameras), POINTS, "sparse/0")
    away = POINTS + np.array([0, 30.0, 0])  # where no camera looks, as it is said to stand; inverted, they all do
    told = inverted([replace(c, viewmat=c.viewmat @ translation(-away.mean(0))) for c in cameras])
    with pytest.raises(CaptureError, match=r"Inverted, they show them: they are camera to world"):
        validate_poses(told, away, "sparse/0")


def translation(by: np.ndarray) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, 3] = by
    return matrix


def test_poses_without_points_give_only_doubts() -> None:
    cameras = RIGS["ring"]
    (outwards,) = validate_poses(with_opengl_axes(cameras), None, "poses.txt")
    assert outwards.startswith(
        "poses.txt: the cameras look away from each other. That is right where they film outwards"
    )
    (other_way,) = validate_poses(inverted(ring(9, width=48, height=32)), None, "poses.txt")
    assert "look past each other" in other_way
    assert "they may be camera to world" in other_way


@pytest.mark.parametrize("nudge", [0.0, *(10.0**-power for power in range(4, 10))])
def test_rounding_does_not_cause_doubts(nudge: float) -> None:
    """Cameras at one distance from the origin look at it. Inverted, their centers are equal except for rounding."""
    rng = np.random.default_rng(0)
    for cameras in (inverted(ring(count, width=48, height=32)) for count in range(4, 12)):
        moved = [replace(c, viewmat=c.viewmat @ translation(nudge * rng.normal(size=3))) for c in cameras]
        (doubt,) = validate_poses(moved, None, "poses.txt")
        assert "they may be camera to world" in doubt
        assert validate_poses(inverted(moved), None, "poses.txt") == []
