"""Opacity resets and the pruning of points that do not recover."""

import numpy as np
import pytest

from splatreel.base.progress import Silent
from splatreel.kernels import adam
from splatreel.kernels.image import render_image
from splatreel.method.cameras.color_gains import CameraGains
from splatreel.method.train.keyframe_trainer import KeyframeTrainer
from splatreel.method.train.opacity_resets import RESET_OPACITY, OpacityResets, reset_opacities
from splatreel.method.train.render import View
from splatreel.method.train.trainable_points import TrainablePoints, default_rates
from splatreel.method.train.training_images import TrainingImages
from splatreel.scene.gaussians import Gaussians
from tests.method.captures import blots
from tests.method.scenes import random_gaussians, ring
from tests.method.small import plain

NEAR, UNIT = 0.1, 4.0
WALL = blots(400, [-3, -2, 0.9], [3, 2, 1.0], 0.14, 0)
BEHIND = blots(100, [-1, -1, 1.8], [1, 1, 2.2], 0.1, 1)
CAMERAS = ring(4, width=48, height=32)


@pytest.mark.parametrize(
    ("total", "views", "resets", "prunings"),
    [(1000, 24, [250, 450], [290, 490]), (1000, 40, [250, 450], [310, 510]), (1000, 80, [], []), (300, 8, [], [])],
)
def test_every_view_is_drawn_before_points_are_pruned(
    total: int, views: int, resets: list[int], prunings: list[int]
) -> None:
    times = OpacityResets(total, views)
    assert (times.resets, times.prunings) == (resets, prunings)
    assert [done for done in range(total) if times.is_due(done)] == sorted(resets + prunings)


def test_reset_lowers_high_opacities_and_forgets_their_momentum() -> None:
    points = TrainablePoints.from_gaussians(random_gaussians(50), default_rates(1.0))
    points.params["logit_opacities"][:2] = -6
    adam.adam(points.follow([np.ones_like(value) for value in points.params.values()]))
    before = points.opacities
    reset_opacities(points)
    np.testing.assert_allclose(points.opacities, np.minimum(before, RESET_OPACITY), rtol=1e-5)
    assert not points.adams["logit_opacities"].mean.any()
    assert not points.adams["logit_opacities"].square.any()


def test_update_prunes_the_faintest_fifth() -> None:
    points = TrainablePoints.from_gaussians(random_gaussians(50), default_rates(1.0))
    opacities = points.opacities
    times = OpacityResets(1000, 4)
    assert not times.update(100, points)
    assert len(points) == 50
    assert times.update(290, points)
    np.testing.assert_array_equal(np.sort(points.opacities), np.sort(opacities)[10:])


def test_training_prunes_opaque_points_that_no_image_shows() -> None:
    """Points behind a wall keep their opacity without a reset."""
    truth = np.stack([render_image(WALL, camera, near=NEAR).clip(0, 1) for camera in CAMERAS])
    pixels = (truth * 255).round().astype(np.uint8)[None]
    images = TrainingImages(pixels, [View.of(camera) for camera in CAMERAS], NEAR, UNIT)
    left = {}
    for detail in (False, True):
        settings = {"keyframe.sh_degree": 0, "keyframe.densify_every": 1000, "keyframe.detail": detail}
        points = TrainablePoints.from_gaussians(Gaussians.concatenate([WALL, BEHIND]), default_rates(UNIT))
        gains = CameraGains(len(CAMERAS), enabled=False)
        trainer = KeyframeTrainer(points, gains, plain(settings).keyframe, max_points=600, seed=0)
        trainer.train(images, 250, 400, Silent())
        left[detail] = int((trainer.points.means[:, 2] > 1.5).sum())
    assert left[True] < 0.6 * left[False]
