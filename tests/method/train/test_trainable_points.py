"""Trainable points and their optimizer."""

import torch

from splatreel.method.train.trainable_points import NAMES, TrainablePoints, default_rates, to_gaussians, to_params
from tests.method.scenes import random_gaussians


def make(count=5):
    return TrainablePoints.from_gaussians(random_gaussians(count), default_rates(1.0), torch.device("cpu"))


def take_a_step(points):
    torch.stack([(p**2).sum() for p in points.params.values()]).sum().backward()
    points.step()


def test_to_params_round_trip():
    gaussians = random_gaussians(20)
    back = to_gaussians(to_params(gaussians, torch.device("cpu")))
    for name in ("means", "quats", "scales", "opacities", "sh"):
        torch.testing.assert_close(
            torch.from_numpy(getattr(back, name)), torch.from_numpy(getattr(gaussians, name)), rtol=1e-4, atol=1e-5
        )


def test_keep_preserves_optimizer_state():
    points = make()
    take_a_step(points)
    before = points.adams["means"].mean.clone()
    points.keep(torch.tensor([3, 1]))
    assert len(points) == 2
    torch.testing.assert_close(points.adams["means"].mean, before[[3, 1]])


def test_append_starts_without_momentum():
    points = make()
    take_a_step(points)
    points.append(points.rows(torch.tensor([0, 2])))
    state = points.adams["means"].mean
    assert len(points) == 7
    assert (state[5:] == 0).all()
    assert (state[:5] != 0).any()
    before = {name: points.params[name].detach().clone() for name in NAMES}
    take_a_step(points)
    assert all((points.params[name][5:] != before[name][5:]).any() for name in NAMES)


def test_price_sh_shrinks_only_higher_bands():
    points = make()
    before = {name: tensor.detach().clone() for name, tensor in points.params.items()}
    (0 * torch.stack([tensor.sum() for tensor in points.params.values()]).sum()).backward()
    points.price_sh(0.1)
    points.step()
    for name in NAMES:
        if name == "sh_rest":
            assert points.params[name].abs().sum() < before[name].abs().sum()
        else:
            torch.testing.assert_close(points.params[name].detach(), before[name])


def test_price_sh_without_gradient_or_price_changes_nothing():
    points = make()
    points.price_sh(0.1)
    assert points.params["sh_rest"].grad is None
    points.params["sh_rest"].grad = torch.zeros_like(points.params["sh_rest"])
    points.price_sh(0.0)
    assert not points.params["sh_rest"].grad.any()


def test_scale_rates_multiplies_base_rates():
    points = make()
    points.scale_rates({"means": 0.5}, default=0.1)
    points.scale_rates({"means": 0.5}, default=0.1)
    rates = {name: adam.rate for name, adam in points.adams.items()}
    assert rates["means"] == 0.5 * default_rates(1.0)["means"]
    assert rates["quats"] == 0.1 * default_rates(1.0)["quats"]
