"""Common parts of density control."""

import numpy as np
import pytest

from splatreel.kernels.image import render_image
from splatreel.method.train.density import GradientMeter, KeyframeDensity, select_growth
from splatreel.method.train.render import View
from splatreel.method.train.trainable_points import TrainablePoints, children, default_rates, halves, rotate, sigmoid
from splatreel.method.train.training_images import TrainingImages
from tests.method.scenes import random_gaussians, ring
from tests.method.small import plain


def floats(values: list) -> np.ndarray:
    return np.array(values, np.float32)


def twice(values: np.ndarray) -> np.ndarray:
    return np.concatenate([values, values])


def test_gradient_meter_averages_over_views_that_see_a_point():
    meter = GradientMeter(3)
    meter.add(floats([[0.03, 0.04], [0.0, 0.0], [1.0, 0.0]]), 2, 2)
    meter.add(floats([[0.06, 0.08], [0.0, 0.0]]), 2, 2, index=np.array([0, 1]))
    np.testing.assert_allclose(meter.mean(), [0.075, 0.0, 1.0], rtol=1e-6)
    assert meter.mean().dtype == np.float32


def test_gradient_meter_uses_normalized_device_units():
    meter = GradientMeter(1)
    meter.add(floats([[1e-3, 0.0]]), 320, 180)
    np.testing.assert_allclose(meter.mean(), [0.16], rtol=1e-6)


def test_select_growth_takes_largest_gradients_within_budget():
    meter = GradientMeter(4)
    meter.add(floats([[0.1, 0], [0.4, 0], [0.2, 0], [0.3, 0]]), 2, 2)
    assert select_growth(meter, 0.15, 10).tolist() == [False, True, True, True]
    assert select_growth(meter, 0.15, 2).tolist() == [False, True, False, True]
    assert not select_growth(meter, 0.15, 0).any()


def test_children_are_near_parent_and_smaller():
    points = TrainablePoints.from_gaussians(random_gaussians(50), default_rates(1.0))
    split = np.zeros(50, bool)
    split[:10] = True
    rows = children(points, split, np.random.default_rng(0))
    assert len(rows["means"]) == 20
    parent = points.rows(split)
    np.testing.assert_allclose(np.exp(rows["log_scales"][:10]) * 1.6, np.exp(parent["log_scales"]), rtol=1e-5)
    reach = np.exp(parent["log_scales"]).max(1)
    assert (np.linalg.norm(rows["means"][:10] - parent["means"], axis=1) < 5 * reach).all()


def test_children_follow_parent_gaussian():
    """Samples use the parent's axes and scales: the children of a needle lie along it."""
    gaussians = random_gaussians(400)
    gaussians.scales[:] = 0.5, 0.05, 0.005
    points = TrainablePoints.from_gaussians(gaussians, default_rates(1.0))
    rows = children(points, np.ones(400, bool), np.random.default_rng(0))
    turned_back = twice(points.quats) * floats([1, -1, -1, -1])
    offsets = rotate(turned_back, rows["means"] - twice(points.means))
    np.testing.assert_allclose(offsets.std(0), [0.5, 0.05, 0.005], rtol=0.1)
    for name in ("quats", "logit_opacities", "sh_base", "sh_rest"):
        np.testing.assert_array_equal(rows[name], twice(points.params[name]))


def test_halves_are_side_by_side_on_the_longest_axis():
    gaussians = random_gaussians(200)
    points = TrainablePoints.from_gaussians(gaussians, default_rates(1.0))
    every = np.ones(200, bool)
    rows, scales = halves(points, every), points.scales
    np.testing.assert_allclose((rows["means"][:200] + rows["means"][200:]) / 2, points.means, rtol=1e-4, atol=1e-6)
    turned_back = points.quats * floats([1, -1, -1, -1])
    longest = np.eye(3, dtype=np.float32)[scales.argmax(1)] * scales
    offsets = rotate(turned_back, rows["means"][:200] - points.means)
    np.testing.assert_allclose(offsets, 0.5 * longest, rtol=1e-4, atol=1e-6)
    shrunk = np.where(longest > 0, 0.5, 0.85)
    np.testing.assert_allclose(np.exp(rows["log_scales"]), twice(scales * shrunk), rtol=1e-5)
    np.testing.assert_allclose(sigmoid(rows["logit_opacities"]), 0.6 * twice(points.opacities), rtol=1e-5)
    for name in ("quats", "sh_base", "sh_rest"):
        np.testing.assert_array_equal(rows[name], twice(points.params[name]))


def test_halves_draw_nearly_what_the_point_draws():
    """The image of a large point changes less by its split into halves than by a split into random children."""
    camera = ring(1, width=64, height=48)[0]
    gaussians = random_gaussians(1)
    gaussians.means[:], gaussians.scales[:], gaussians.opacities[:] = 0, (0.6, 0.2, 0.2), 0.8
    points = TrainablePoints.from_gaussians(gaussians, default_rates(1.0))
    every, before = np.ones(1, bool), render_image(gaussians, camera)

    def change(rows: dict[str, np.ndarray]) -> float:
        after = TrainablePoints(rows, default_rates(1.0)).gaussians()
        return float(np.abs(render_image(after, camera) - before).mean())

    random = [change(children(points, every, np.random.default_rng(seed))) for seed in range(5)]
    assert change(halves(points, every)) < 0.8 * min(random)


def test_rotate_turns_x_to_y_about_z():
    quarter = floats([[0.5**0.5, 0, 0, 0.5**0.5]])
    np.testing.assert_allclose(rotate(quarter, floats([[1, 0, 0]])), [[0, 1, 0]], atol=1e-6)


@pytest.mark.parametrize(
    ("width", "absolute", "grown"), [(160, True, 0), (320, True, 0), (720, True, 5), (720, False, 20)]
)
def test_large_images_are_densified_at_smaller_absolute_gradients(width: int, absolute: bool, grown: int) -> None:
    """Five of twenty points have a gradient below the threshold of a small image, but above that of a large one."""
    points = TrainablePoints.from_gaussians(random_gaussians(20), default_rates(1.0))
    view = View.of(ring(1, width=width, height=width // 2)[0])
    images = TrainingImages(np.zeros((1, 1, width // 2, width, 3), np.uint8), [view], 0.1, 4.0)
    density = KeyframeDensity(points, plain({}).keyframe, 1000, seed=0)
    density.restart(images)
    density.meter.sum[:], density.meter.seen[:] = 2.5e-4, 1
    density.meter.sum[:5] = 3.5e-4
    density.densify(images, 0.1, absolute)
    assert len(points) == 20 + grown
