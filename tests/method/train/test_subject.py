"""Tests of `method/train/subject.py`."""

from dataclasses import replace
from typing import Any, cast

import numpy as np

from splatreel.capture.masks import LIKELY
from splatreel.config import KeyframeConfig
from splatreel.kernels import photometric, splat
from splatreel.method.train.dynamic_points import DynamicPoints
from splatreel.method.train.keyframe_trainer import starting_points
from splatreel.method.train.render import StaticCache, View, deformed, draw
from splatreel.method.train.subject import (
    bound_colors,
    opposite_view,
    seen_shares,
    spread_colors,
    spread_colors_of_group,
    with_opposite,
)
from splatreel.method.train.trainable_points import TrainablePoints, default_rates
from splatreel.method.train.training_images import TrainingImages
from splatreel.scene.gaussians import C0, Gaussians
from tests.method.scenes import look_at, ring

GAIN = np.array([0.5, 1.0, 2.0], np.float32)


def subject_images() -> tuple[TrainingImages, np.ndarray]:
    """Return images of a gray square before red, and its opacity."""
    camera = ring(1, width=32, height=32)[0]
    view = View.of(camera)
    view = replace(view, background=np.array([1.0, 0, 0], np.float32) / GAIN, gain=GAIN)
    alpha = np.zeros((1, 1, 32, 32), np.uint8)
    alpha[..., 8:24, 8:24] = 255
    pixels = np.zeros((1, 1, 32, 32, 3), np.uint8)
    pixels[..., 0] = 255
    pixels[alpha == 255] = 100
    return TrainingImages(pixels, [view], 0.1, 4.0), alpha


def test_only_the_background_changes_to_its_opposite() -> None:
    images, alpha = subject_images()
    both = with_opposite(images, alpha)
    assert both.opposite is not None
    assert both.opposite.pixels[0, 0, 0, 0].tolist() == [0, 255, 255]
    assert both.opposite.pixels[0, 0, 16, 16].tolist() == [100, 100, 100]
    assert both.pixels is images.pixels
    background = both.opposite.views[0].background
    assert background is not None
    np.testing.assert_allclose(background * GAIN, [0, 1, 1], rtol=1e-6)


def test_doubtful_pixels_become_unknown_together_with_those_that_are() -> None:
    images, alpha = subject_images()
    assert with_opposite(images, alpha).unknown is None
    alpha[..., 3, 4] = LIKELY
    known = np.zeros(alpha.shape, bool)
    known[..., 5, 6] = True
    for before, count in ((None, 1), (known, 2)):
        both = with_opposite(replace(images, unknown=before), alpha)
        assert both.unknown is not None
        assert both.opposite is not None
        assert both.unknown[0, 0, 3, 4]
        assert both.unknown.sum() == count
        assert both.opposite.unknown is both.unknown


def test_view_before_black_has_white_as_its_opposite() -> None:
    view = View.of(ring(1, width=32, height=32)[0])
    background = opposite_view(view).background
    assert background is not None
    assert background.tolist() == [1, 1, 1]


def test_rounds_over_all_cameras_alternate_between_the_backgrounds() -> None:
    images, alpha = subject_images()
    both = with_opposite(images, alpha)
    assert [both.of_iteration(k)[0] is both for k in range(4)] == [True, False, True, False]
    assert [both.of_iteration(k)[1] for k in range(4)] == [0, 1, 0, 1]
    assert images.of_iteration(1) == (images, 0)
    assert both.halved().opposite.pixels.shape == (1, 1, 16, 16, 3)
    assert len(both.all_views) == 2


def test_point_of_the_color_of_the_background_is_wrong_before_its_opposite() -> None:
    images, alpha = subject_images()
    view = replace(images.views[0], gain=None, background=np.array([1.0, 0, 0], np.float32))
    both = with_opposite(replace(images, views=[view]), alpha)

    def slope(iteration: int) -> float:
        """Return the derivative of the loss by the opacity of a red point beside the subject."""
        shown, _ = both.of_iteration(iteration)
        points = starting_points(np.array([[1.4, 1.4, 0]]), np.array([[1.0, 0, 0]]), KeyframeConfig(), 4.0)
        seen, target = shown.views[0], shown.pixels[0, 0]
        splats = deformed(points.params, None, None, seen, 0.1)
        image, alpha = draw(splats, seen)
        d_image = photometric.loss_and_gradient(image, target, 0.0).d_image
        drawn = splat.rasterize(splats, 32, 32)[0]
        return float(splat.rasterize_gradient(splats, 32, 32, drawn, alpha, d_image).opacities[0])

    assert abs(slope(0)) < 1e-6, "nothing contradicts a red point before red"
    assert slope(1) > 1e-4


def wall(back_color: float) -> tuple[TrainablePoints, TrainingImages]:
    """Return a dark opaque wall before a camera, with one point of another color behind it, which the camera cannot see."""
    x, y = np.meshgrid(np.linspace(-1, 1, 15), np.linspace(-1, 1, 15))
    front = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], 1)
    means = np.concatenate([front, [[0, 0, 0.3]]])
    colors = np.full((len(means), 1, 3), (0.1 - 0.5) / C0)
    colors[-1] = (back_color - 0.5) / C0
    sh = np.concatenate([colors, np.full((len(means), 3, 3), 0.2)], 1)
    quats = np.tile([1.0, 0, 0, 0], (len(means), 1))
    points = Gaussians(means, quats, np.full((len(means), 3), 0.1), np.full(len(means), 0.98), sh)
    views = [View.of(look_at([0, 0, -4]))]
    images = TrainingImages(np.zeros((1, 1, 32, 48, 3), np.uint8), views, 0.1, 4.0)
    return TrainablePoints.from_gaussians(points, default_rates(4.0)), images


def test_hidden_points_have_no_share() -> None:
    points, images = wall(0.9)
    shares = seen_shares(points, images, None)
    assert shares[-1] < 0.01
    assert shares[:-1].min() > 0.2


def test_hidden_point_takes_the_color_around_it() -> None:
    points, images = wall(0.9)
    before = points.params["sh_base"].copy()
    spread_colors(points, seen_shares(points, images, None))
    color = 0.5 + C0 * points.params["sh_base"][:, 0]
    np.testing.assert_allclose(color[-1], np.full(3, 0.1), atol=0.02)
    assert np.abs(points.params["sh_rest"][-1]).max() < 0.01
    np.testing.assert_allclose(points.params["sh_base"][:-1], before[:-1], atol=0.02)


class Rising:
    """Motion of the last point of a wall: from behind the wall to in front of it, along -z."""

    def offsets(self, means: np.ndarray, moment: float) -> tuple[np.ndarray, np.ndarray]:
        dx, dq = np.zeros_like(means), np.tile(np.array([1, 0, 0, 0], np.float32), (len(means), 1))
        dx[-1, 2] = -0.2 * moment
        return dx, dq


def test_points_of_a_group_keep_their_color_if_any_frame_shows_them() -> None:
    for frames, kept in ((1, False), (6, True)):
        points, images = wall(0.9)
        images = replace(images, pixels=np.zeros((frames, 1, 32, 48, 3), np.uint8))
        static = StaticCache(Gaussians.empty(1), images.views, images.near)
        spread_colors_of_group(DynamicPoints(points, cast(Any, Rising()), None), images, static)
        color = 0.5 + C0 * points.params["sh_base"][-1, 0]
        np.testing.assert_allclose(color, np.full(3, 0.9 if kept else 0.1), atol=0.02)


def test_colors_stay_within_what_images_hold() -> None:
    points, _ = wall(3.0)
    bound_colors(points)
    assert float(0.5 + C0 * points.params["sh_base"][-1].max()) <= 1 + 1e-6
