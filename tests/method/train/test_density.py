"""Common parts of density control."""

import numpy as np
import pytest
import torch

from splatreel.kernels.image import render_image
from splatreel.method.train.density import GradientMeter, KeyframeDensity, select_growth
from splatreel.method.train.render import View
from splatreel.method.train.trainable_points import TrainablePoints, children, default_rates, halves, rotate
from splatreel.method.train.training_images import TrainingImages
from tests.method.scenes import random_gaussians, ring
from tests.method.small import plain


def test_gradient_meter_averages_over_views_that_see_a_point():
    meter = GradientMeter(3, torch.device("cpu"))
    meter.add(torch.tensor([[0.03, 0.04], [0.0, 0.0], [1.0, 0.0]]), 2, 2)
    meter.add(torch.tensor([[0.06, 0.08], [0.0, 0.0]]), 2, 2, index=torch.tensor([0, 1]))
    torch.testing.assert_close(meter.mean(), torch.tensor([0.075, 0.0, 1.0]))


def test_gradient_meter_uses_normalized_device_units():
    meter = GradientMeter(1, torch.device("cpu"))
    meter.add(torch.tensor([[1e-3, 0.0]]), 320, 180)
    torch.testing.assert_close(meter.mean(), torch.tensor([0.16]))


def test_select_growth_takes_largest_gradients_within_budget():
    meter = GradientMeter(4, torch.device("cpu"))
    meter.add(torch.tensor([[0.1, 0], [0.4, 0], [0.2, 0], [0.3, 0]]), 2, 2)
    assert select_growth(meter, 0.15, 10).tolist() == [False, True, True, True]
    assert select_growth(meter, 0.15, 2).tolist() == [False, True, False, True]
    assert not select_growth(meter, 0.15, 0).any()


def test_children_are_near_parent_and_smaller():
    points = TrainablePoints.from_gaussians(random_gaussians(50), default_rates(1.0), torch.device("cpu"))
    split = torch.zeros(50, dtype=torch.bool)
    split[:10] = True
    rows = children(points, split, torch.Generator().manual_seed(0))
    assert len(rows["means"]) == 20
    parent = points.rows(split)
    torch.testing.assert_close(rows["log_scales"][:10].exp() * 1.6, parent["log_scales"].exp())
    reach = parent["log_scales"].exp().amax(1)
    assert ((rows["means"][:10] - parent["means"]).norm(dim=1) < 5 * reach).all()


def test_children_follow_parent_gaussian():
    """Samples use the parent's axes and scales: the children of a needle lie along it."""
    gaussians = random_gaussians(400)
    gaussians.scales[:] = 0.5, 0.05, 0.005
    points = TrainablePoints.from_gaussians(gaussians, default_rates(1.0), torch.device("cpu"))
    rows = children(points, torch.ones(400, dtype=torch.bool), torch.Generator().manual_seed(0))
    turned_back = points.rows(torch.ones(400, dtype=torch.bool))["quats"].repeat(2, 1) * torch.tensor([1.0, -1, -1, -1])
    offsets = rotate(turned_back, rows["means"] - points.means.detach().repeat(2, 1))
    torch.testing.assert_close(offsets.std(0), torch.tensor([0.5, 0.05, 0.005]), rtol=0.1, atol=0)
    for name in ("quats", "logit_opacities", "sh_base", "sh_rest"):
        assert torch.equal(rows[name], points.params[name].detach().repeat(2, *[1] * (rows[name].ndim - 1)))


def test_halves_are_side_by_side_on_the_longest_axis():
    gaussians = random_gaussians(200)
    points = TrainablePoints.from_gaussians(gaussians, default_rates(1.0), torch.device("cpu"))
    every = torch.ones(200, dtype=torch.bool)
    rows, scales = halves(points, every), points.scales.detach()
    torch.testing.assert_close((rows["means"][:200] + rows["means"][200:]) / 2, points.means.detach())
    turned_back = points.rows(every)["quats"] * torch.tensor([1.0, -1, -1, -1])
    longest = torch.nn.functional.one_hot(scales.argmax(1), 3) * scales
    offsets = rotate(turned_back, rows["means"][:200] - points.means.detach())
    torch.testing.assert_close(offsets, 0.5 * longest, rtol=1e-4, atol=1e-6)
    shrunk = torch.where(longest > 0, 0.5, 0.85)
    torch.testing.assert_close(rows["log_scales"].exp(), (scales * shrunk).repeat(2, 1))
    torch.testing.assert_close(torch.sigmoid(rows["logit_opacities"]), 0.6 * points.opacities.detach().repeat(2))
    for name in ("quats", "sh_base", "sh_rest"):
        assert torch.equal(rows[name], points.params[name].detach().repeat(2, *[1] * (rows[name].ndim - 1)))


def test_halves_draw_nearly_what_the_point_draws():
    """The image of a large point changes less by its split into halves than by a split into random children."""
    camera = ring(1, width=64, height=48)[0]
    gaussians = random_gaussians(1)
    gaussians.means[:], gaussians.scales[:], gaussians.opacities[:] = 0, (0.6, 0.2, 0.2), 0.8
    points = TrainablePoints.from_gaussians(gaussians, default_rates(1.0), torch.device("cpu"))
    every, before = torch.ones(1, dtype=torch.bool), render_image(gaussians, camera)

    def change(rows: dict[str, torch.Tensor]) -> float:
        after = TrainablePoints(rows, default_rates(1.0)).gaussians()
        return float(np.abs(render_image(after, camera) - before).mean())

    random = [change(children(points, every, torch.Generator().manual_seed(seed))) for seed in range(5)]
    assert change(halves(points, every)) < 0.8 * min(random)


def test_rotate_turns_x_to_y_about_z():
    quarter = torch.tensor([[0.5**0.5, 0, 0, 0.5**0.5]])
    torch.testing.assert_close(rotate(quarter, torch.tensor([[1.0, 0, 0]])), torch.tensor([[0.0, 1, 0]]))


@pytest.mark.parametrize(
    ("width", "absolute", "grown"), [(160, True, 0), (320, True, 0), (720, True, 5), (720, False, 20)]
)
def test_large_images_are_densified_at_smaller_absolute_gradients(width: int, absolute: bool, grown: int) -> None:
    """Five of twenty points have a gradient below the threshold of a small image, but above that of a large one."""
    points = TrainablePoints.from_gaussians(random_gaussians(20), default_rates(1.0), torch.device("cpu"))
    view = View.of(ring(1, width=width, height=width // 2)[0], torch.device("cpu"))
    images = TrainingImages(torch.zeros(1, 1, width // 2, width, 3, dtype=torch.uint8), [view], 0.1, 4.0)
    density = KeyframeDensity(points, plain({}).keyframe, 1000, seed=0)
    density.restart(images)
    density.meter.sum[:], density.meter.seen[:] = 2.5e-4, 1
    density.meter.sum[:5] = 3.5e-4
    density.densify(images, 0.1, absolute)
    assert len(points) == 20 + grown
