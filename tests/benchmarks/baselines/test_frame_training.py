from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from baselines import frame_training
from baselines.shared_start import SharedStart
from splatreel.evaluation.metrics import psnr
from splatreel.kernels.image import render_image
from splatreel.method.train.trainable_points import to_params
from splatreel.scene.gaussians import Gaussians
from tests.benchmarks.baselines.starts import still, write_start
from tests.evaluation import scenes

SHIFT = np.array([0.06, 0.0, 0.0], np.float32)


@pytest.fixture
def start(tmp_path: Path) -> SharedStart:
    """A run whose keyframe is beside the truth: everything has moved since."""
    truth = scenes.truth(0)
    return write_start(still(tmp_path), tmp_path / "run", replace(truth, means=truth.means - SHIFT))


def error(points: Gaussians, start: SharedStart, camera: str = "cam00") -> float:
    """Return the PSNR in a view of the scene, by default a held-out one."""
    view = start.capture.camera(camera)
    truth = start.capture.read(1, 1, [camera])[0, 0].astype(np.float32) / 255
    return psnr(np.clip(render_image(points, view, near=start.layout.near), 0, 1), truth)


def test_moved_points_follow(start: SharedStart) -> None:
    moved, _ = frame_training.move_points(start, start.keyframe, start.training_images(1), 40, 1)
    assert error(moved, start) > error(start.keyframe, start) + 2
    assert (moved.means - start.keyframe.means).mean(0) == pytest.approx(SHIFT, abs=0.03)
    assert (moved.scales == start.keyframe.scales).all()


def test_image_gradients_are_those_of_finite_differences(start: SharedStart) -> None:
    """A gain and a background take part. The target is far from the drawing, where absolute differences have a derivative."""
    plain, gain, count = start.training_images(1), np.array([1.1, 0.9, 1.0], np.float32), len(start.keyframe)
    views = [replace(view, background=np.array([0.1, 0.2, 0.3], np.float32)) for view in plain.views]
    images = replace(plain, views=views, pixels=np.full_like(plain.pixels, 255))
    params = to_params(start.keyframe)
    offsets = np.zeros((count, 3), np.float32), np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1))
    found = frame_training.image_gradients(params, offsets, images, 0, gain)
    arrays = [(offsets[0], found.points["means"]), (offsets[1], found.dq)]
    arrays += [(params[name], found.points[name]) for name in ("log_scales", "logit_opacities", "sh_base")]
    for value, slope in arrays:
        assert value.shape == slope.shape
        before, size, ends = value.copy(), float(np.linalg.norm(slope)), []
        step = 2e-2 * slope / np.abs(slope).max()
        for sign in (1, -1):
            value[:] = before + sign * step
            ends.append(frame_training.image_gradients(params, offsets, images, 0, gain).loss)
        value[:] = before
        assert (ends[0] - ends[1]) / (2 * float(np.linalg.norm(step))) == pytest.approx(size, rel=0.05)


def test_unknown_pixels_cause_no_loss(start: SharedStart) -> None:
    images, gain = start.training_images(1), np.ones(3, np.float32)
    nothing = replace(images, unknown=np.ones(images.pixels.shape[:-1], bool))
    full, none = (
        frame_training.image_gradients(to_params(start.keyframe), None, each, 0, gain) for each in (images, nothing)
    )
    assert none.loss < 0.01 < full.loss


def test_training_in_place_keeps_points_and_sizes(start: SharedStart) -> None:
    trained = frame_training.train_in_place(start, start.keyframe, start.training_images(1), 30, 1)
    assert len(trained) == len(start.keyframe)
    np.testing.assert_allclose(trained.scales, start.keyframe.scales, rtol=1e-5)
    assert error(trained, start) > error(start.keyframe, start) + 1


def test_free_training_follows(start: SharedStart) -> None:
    trained = frame_training.train_freely(start, start.keyframe, start.training_images(1), 30, 1)
    assert error(trained, start) > error(start.keyframe, start) + 1


def test_points_are_added_where_they_lack(start: SharedStart) -> None:
    truth = scenes.truth(0)
    half = truth[::2]
    _, meter = frame_training.move_points(start, half, start.training_images(1), 4, 1)
    added = frame_training.add_points(start, half, meter, start.training_images(1), 100, 1)
    assert 0 < len(added) <= 0.02 * len(half) + 1
    both = Gaussians.concatenate([half, added])
    assert sum(error(both, start, name) - error(half, start, name) for name in start.rig.names) > 0
    assert len(frame_training.add_points(start, half, meter, start.training_images(1), 2, 1)) == 0
