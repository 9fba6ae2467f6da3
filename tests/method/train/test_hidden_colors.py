"""Tests of `method/train/hidden_colors.py`."""

import numpy as np

from splatreel.method.train.hidden_colors import bound_colors, seen_shares, spread_colors
from splatreel.method.train.render import View
from splatreel.method.train.trainable_points import TrainablePoints, default_rates
from splatreel.method.train.training_images import TrainingImages
from splatreel.scene.gaussians import C0, Gaussians
from tests.method.scenes import look_at


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
    spread_colors(points, images, None)
    color = 0.5 + C0 * points.params["sh_base"][:, 0]
    np.testing.assert_allclose(color[-1], np.full(3, 0.1), atol=0.02)
    assert np.abs(points.params["sh_rest"][-1]).max() < 0.01
    np.testing.assert_allclose(points.params["sh_base"][:-1], before[:-1], atol=0.02)


def test_colors_stay_within_what_images_hold() -> None:
    points, _ = wall(3.0)
    bound_colors(points)
    assert float(0.5 + C0 * points.params["sh_base"][-1].max()) <= 1 + 1e-6
