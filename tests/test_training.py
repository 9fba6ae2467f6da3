"""Training from arrays by the public functions of `splatreel.training`."""

import re
import subprocess
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import splatreel
from splatreel.base.errors import CaptureError, GaussiansError, UsageError
from splatreel.capture.pose_checks import inverted
from splatreel.scene.camera import facing
from splatreel.training import group_trainer, reconstruct_frame
from tests.method.scenes import ring
from tests.method.small import small

T, COUNT = 3, 6
CAMERAS = ring(4, width=32, height=24)
IMAGES = np.random.default_rng(0).integers(0, 256, (T, len(CAMERAS), 24, 32, 3)).astype(np.uint8)


def ball() -> splatreel.Gaussians:
    rng = np.random.default_rng(1)
    return splatreel.Gaussians(
        means=rng.uniform(-0.3, 0.3, (COUNT, 3)),
        quats=np.tile([1.0, 0, 0, 0], (COUNT, 1)),
        scales=np.full((COUNT, 3), 0.1),
        opacities=np.full(COUNT, 0.9),
        sh=np.zeros((COUNT, 1, 3)),
    )


def settings(deformation: str = "trajectory") -> splatreel.Config:
    return small({"group.deformation": deformation, "group.iterations_per_frame": 2})


@pytest.mark.parametrize("images", [IMAGES, IMAGES / 255], ids=["bytes", "floats"])
@pytest.mark.parametrize("deformation", ["trajectory", "hashgrid"])
def test_a_group_is_trained_step_by_step(deformation: str, images: np.ndarray) -> None:
    wall = ball()
    trainer = group_trainer(images, CAMERAS, ball(), wall, settings(deformation), near=0.1, device="cpu")
    assert trainer.iterations == 2 * T
    losses = [float(trainer.step(iteration)) for iteration in range(trainer.iterations)]
    assert np.isfinite(losses).all()
    result = trainer.result()
    assert (result.dx.shape, result.dq.shape, len(result.alive)) == ((T, COUNT, 3), (T, COUNT, 4), len(wall))
    assert np.abs(result.dx[-1]).max() > 0


def test_training_starts_from_tracks() -> None:
    moves = np.linspace(0, 0.2, T)[:, None, None] * np.array([1.0, 0, 0])
    tracks = ball().means + np.broadcast_to(moves, (T, COUNT, 3))
    trainer = group_trainer(IMAGES, CAMERAS, ball(), None, settings(), near=0.1, tracks=tracks, device="cpu")
    assert np.allclose(trainer.result().dx[-1], moves[-1], atol=0.02)


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"images": IMAGES[0]}, CaptureError, r"The group: images have shape \(4, 24, 32, 3\)"),
        ({"images": IMAGES * 1.0}, CaptureError, "Give uint8, or floats 0..1"),
        ({"near": 100.0}, GaussiansError, "All Gaussians are behind the near plane: it is at 100"),
        ({"dynamic": splatreel.Gaussians.empty()}, GaussiansError, "There are no dynamic Gaussians"),
        (
            {"cameras": [replace(camera, name="a") for camera in CAMERAS]},
            CaptureError,
            "two cameras have the same name",
        ),
        ({"near": 0.0}, UsageError, "near plane is 0.0"),
        ({"near": float("nan")}, UsageError, "near plane is nan"),
        (
            {"tracks": np.zeros((T, COUNT + 1, 3))},
            GaussiansError,
            r"\(3, 7, 3\), expected finite positions \(3, 6, 3\)",
        ),
        ({"tracks": np.full((T, COUNT, 3), np.inf)}, GaussiansError, "expected finite positions"),
        ({"dynamic": replace(ball(), means=np.full((COUNT, 3), np.nan))}, GaussiansError, "The dynamic Gaussians"),
        ({"static": replace(ball(), sh=np.full((COUNT, 1, 3), np.inf))}, GaussiansError, "The static Gaussians"),
        ({"device": "tpu"}, UsageError, "Unknown device 'tpu'"),
        ({"config": "best"}, UsageError, "Unknown quality 'best'"),
    ],
)
def test_arguments_that_do_not_fit_are_named(changes: dict[str, Any], error: type[Exception], message: str) -> None:
    given = {"images": IMAGES, "cameras": CAMERAS, "dynamic": ball(), "near": 0.1} | changes
    with pytest.raises(error, match=message):
        group_trainer(**given)


def test_a_frame_is_reconstructed_from_its_images() -> None:
    points = np.random.default_rng(2).uniform(-0.3, 0.3, (200, 3)).astype(np.float32)
    config = small({"keyframe.first_iterations": 2})
    gaussians = reconstruct_frame(IMAGES[0] / 255, CAMERAS, config, points=points, device="cpu")
    assert len(gaussians) >= 100
    gaussians.check_finite()
    with pytest.raises(CaptureError, match="The frame: images have shape"):
        reconstruct_frame(IMAGES, CAMERAS, config)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"points": np.full((9, 3), np.nan)}, "The frame: 9 of 9 points are NaN"),
        ({"points": np.zeros((9, 3)), "point_colors": np.zeros((8, 3))}, "9 points and 8 point_colors"),
        ({"points": np.zeros((9, 3)), "point_colors": np.full((9, 3), 200)}, "Divide colors of 0..255 by 255"),
        ({"cameras": [replace(c, K=np.diag([9, 9, 1]) @ c.K) for c in CAMERAS]}, "the center of images of 288x216"),
        ({"cameras": inverted(CAMERAS)}, r"they are camera to world.*np.linalg.inv\(pose\)"),
        ({"cameras": [replace(c, viewmat=np.diag([2, 2, 2, 1]) @ c.viewmat) for c in CAMERAS]}, "no rotation"),
    ],
)
def test_a_frame_that_cannot_be_reconstructed_is_refused_at_once(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(CaptureError, match=message):
        reconstruct_frame(**({"images": IMAGES[0], "cameras": CAMERAS, "device": "cpu"} | changes))


def test_the_near_plane_of_training_is_that_of_rendering() -> None:
    points = np.random.default_rng(2).uniform(-0.3, 0.3, (200, 3)).astype(np.float32)
    config = small({"keyframe.first_iterations": 2})
    gaussians = reconstruct_frame(IMAGES[0], CAMERAS, config, points=points, device="cpu")
    assert gaussians.near is not None
    assert gaussians.near > 0.05
    close = facing("close", gaussians.means[0] - [0, 0, 0.5 * gaussians.near], np.array([0, 0, 1.0]), 30, 32, 24)
    cut = splatreel.render(gaussians, close)
    assert np.array_equal(cut, splatreel.render(gaussians, close, near=gaussians.near))
    assert not np.array_equal(cut, splatreel.render(gaussians, close, near=0.01))
    parts = [gaussians[:4], gaussians.at_degree(0), replace(gaussians, near=None), gaussians.faded(0.5)]
    assert [part.near for part in parts] == [gaussians.near, gaussians.near, None, gaussians.near]
    assert splatreel.Gaussians.concatenate(parts).near == gaussians.near
    trainer = group_trainer(IMAGES, CAMERAS, gaussians, None, settings(), device="cpu")
    assert trainer.images.near == trainer.result().dynamic.near == gaussians.near
    assert group_trainer(IMAGES, CAMERAS, replace(gaussians, near=None), None, settings(), device="cpu").images.near > 0


def test_a_missing_package_gives_the_message_of_the_command_line() -> None:
    code = """
import sys
sys.modules["cv2"] = None
import numpy as np
import splatreel
from splatreel.capture.pose_checks import inverted
from splatreel.scene.camera import facing
from splatreel.training import reconstruct_frame
camera = splatreel.Camera("a", np.eye(4), np.array([[8, 0, 4], [0, 8, 4], [0, 0, 1]]), 8, 8)
try:
    reconstruct_frame(np.zeros((1, 8, 8, 3), np.uint8), [camera])
except splatreel.SplatreelError as error:
    print(error)
"""
    printed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert re.match(r"the Python package 'cv2' is needed and not installed\. Run\n  pip install", printed)
