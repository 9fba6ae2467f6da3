"""Regularizers of motion and of surfaces."""

from typing import Any, cast

import numpy as np
import pytest
import torch

from splatreel.evaluation.bench.microbenchmarks import front_camera
from splatreel.kernels.projected import Splats
from splatreel.method.deform.trajectory import Trajectory
from splatreel.method.train import regularizers
from splatreel.method.train.render import View, splats
from splatreel.method.train.trainable_points import rotate
from splatreel.scene.camera import Camera


def grid():
    axis = torch.linspace(-1, 1, 4)
    return torch.stack(torch.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)


def arap(means, dx, dq, unit=1.0):
    neighbor = torch.arange(1, len(means) + 1) % len(means)
    return regularizers.arap(means, dx, dq, neighbor, torch.ones(len(means)), unit)


def test_arap_of_rigid_motion_is_zero():
    means = grid()
    dq = torch.tensor([[0.8, 0.0, 0.6, 0.0]]).expand(len(means), 4)
    dx = rotate(dq, means) + torch.tensor([0.3, -0.2, 0.5]) - means
    assert arap(means, dx, dq) < 1e-4


@pytest.mark.parametrize("kind", ["stretch", "twist"])
def test_arap_of_stretching_and_twisting_is_positive(kind):
    means = grid()
    dq = torch.tensor([[1.0, 0, 0, 0]]).repeat(len(means), 1)
    dx = torch.zeros_like(means)
    if kind == "stretch":
        dx = 0.2 * means
    else:
        dq[::2] = torch.tensor([0.8, 0.6, 0, 0])
    assert arap(means, dx, dq) > 0.05


def test_arap_is_independent_of_scale():
    means, dx = grid(), 0.1 * grid().sin()
    dq = torch.tensor([[1.0, 0, 0, 0]]).repeat(len(means), 1)
    small, large = arap(means, dx, dq), arap(1000 * means, 1000 * dx, dq, 1000.0)
    torch.testing.assert_close(small, large, rtol=1e-3, atol=1e-6)


class Polynomial:
    """Deformation with offsets t^power."""

    def __init__(self, power):
        self.power = power

    def offsets(self, means, frame):
        return torch.full_like(means, float(frame) ** self.power), torch.ones(len(means), 4)


def test_temporal_penalizes_acceleration_only():
    means = grid()
    assert regularizers.temporal(cast(Any, Polynomial(1)), means, 2, 4, 0.3, 1.0) < 1e-5
    expected = 3 * abs(0.7 * 4 + 0.3 * 16 - 2.6**2)
    torch.testing.assert_close(
        regularizers.temporal(cast(Any, Polynomial(2)), means, 2, 4, 0.3, 1.0).item(), expected, rtol=1e-4, atol=0
    )


def test_regularizers_give_gradients_to_parameters():
    means = grid()
    model = Trajectory(means, 10, 1.0)
    dx, dq = model.offsets(means, 3)
    loss = arap(means, dx + 0.1 * means, dq) + regularizers.temporal(model, means, 2, 4, 0.5, 1.0)
    loss.backward()
    grads = [leaf.grad for seen in model.evaluations for leaf in (seen.dx, seen.dq)]
    assert grads
    assert all(grad is not None and torch.isfinite(grad).all() for grad in grads)


def test_neighbors_are_ranked_and_weighted_by_distance():
    means = torch.tensor([[0.0, 0, 0], [1, 0, 0], [3, 0, 0], [3, 0.1, 0]])
    found = regularizers.Neighbors.of(means, 8)
    assert found is not None
    assert found.index.shape == found.closeness.shape == (3, 4)
    assert found.index[0].tolist() == [1, 0, 3, 2]
    assert (found.closeness[0] > found.closeness[2]).all()
    assert regularizers.Neighbors.of(means[:1], 8) is None


def seen(depths: list[float], opacities: list[float], scale: float = 1.0) -> tuple[Splats, View, torch.Tensor]:
    """Return splats that each fill the view of one camera, and their opacities, which get gradients."""
    camera = front_camera(32, 24)
    center, forward = camera.center * scale, camera.forward
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = camera.viewmat[:3, :3], -camera.viewmat[:3, :3] @ center
    view = View.of(Camera("a", pose, camera.K, 32, 24), torch.device("cpu"))
    count = len(depths)
    means = torch.from_numpy(np.stack([center + scale * depth * forward for depth in depths])).float()
    given = torch.tensor(opacities, requires_grad=True)
    quats = torch.tensor([[1.0, 0, 0, 0]]).expand(count, 4).contiguous()
    scales = scale * 20 * torch.tensor(depths)[:, None].expand(count, 3).contiguous()
    colors = torch.zeros(count, 1, 3), torch.zeros(count, 0, 3)
    return splats(means, quats, scales, given, colors, view, 0.1 * scale), view, given


def test_spread_of_one_depth_is_zero():
    points, view, _ = seen([3.0, 3.0], [0.6, 0.9])
    assert regularizers.spread(regularizers.Depths.of(points, view, 0.1)) < 1e-4


@pytest.mark.parametrize("scale", [1.0, 1000.0])
@pytest.mark.parametrize("behind", [2.5, 4.0])
def test_spread_grows_with_distance_to_surface(scale: float, behind: float) -> None:
    points, view, opacities = seen([2.0, behind], [0.2, 0.9], scale)
    spread = regularizers.spread(regularizers.Depths.of(points, view, 0.1 * scale))
    first, second, apart = 0.2, 0.8 * 0.9, np.log(behind / 2)
    share = second / (first + second)
    assert spread.item() == pytest.approx(first * share**2 * min(apart, regularizers.MAX_SEPARATION) ** 2, rel=0.02)
    spread.backward()
    assert opacities.grad is not None
    assert opacities.grad[0] > 0, "the floater shall fade"
    assert opacities.grad[0] > opacities.grad[1]


@pytest.mark.parametrize("mist", [0.1, 0.4, 0.6, 0.9])
def test_spread_fades_mist_of_any_thickness(mist: float) -> None:
    """The symmetric variance of depths would make mist grow if it fills more than half of a pixel."""
    points, view, opacities = seen([1.0, 4.0], [mist, 0.95])
    regularizers.spread(regularizers.Depths.of(points, view, 0.1)).backward()
    assert opacities.grad is not None
    assert opacities.grad[0] > 0
    assert opacities.grad[1] <= 0, "the surface stays"


def test_spread_is_finite_for_many_layers_and_none() -> None:
    for depths, shown in (
        ([0.2, 1.0, 1.1, 3.0, 40.0], [0.3] * 5),
        ([2.0, 3.0], [0.0, 0.0]),
        ([2.0, 2.0000001], [0.5, 0.5]),
    ):
        points, view, opacities = seen(depths, shown)
        spread = regularizers.spread(regularizers.Depths.of(points, view, 0.1))
        spread.backward()
        assert opacities.grad is not None
        assert torch.isfinite(spread)
        assert torch.isfinite(opacities.grad).all()


def corrugated(amplitude: float, slope: float = 0.0) -> tuple[Splats, View, torch.Tensor]:
    """Return a wall of small splats that is tilted by `slope`; every other column is displaced."""
    camera = front_camera(48, 32)
    columns, rows = np.meshgrid(np.arange(1, 48, 2.0), np.arange(1, 32, 2.0))
    depth = 1 / (0.3 + slope * columns + amplitude * (np.arange(columns.shape[1]) % 2))
    local = np.stack([(columns - 24) / camera.K[0, 0], (rows - 16) / camera.K[1, 1], np.ones_like(depth)], -1)
    means = (local * depth[..., None]).reshape(-1, 3) @ camera.viewmat[:3, :3] + camera.center
    count = len(means)
    given = torch.full((count,), 0.9, requires_grad=True)
    quats = torch.tensor([[1.0, 0, 0, 0]]).expand(count, 4).contiguous()
    scales = torch.from_numpy(depth.reshape(-1, 1) / camera.K[0, 0]).float().expand(count, 3).contiguous()
    view = View.of(camera, torch.device("cpu"))
    colors = torch.zeros(count, 1, 3), torch.zeros(count, 0, 3)
    return splats(torch.from_numpy(means).float(), quats, scales, given, colors, view, 0.1), view, given


def rough(amplitude: float, slope: float = 0.0, edges: bool = False) -> torch.Tensor:
    points, view, _ = corrugated(amplitude, slope)
    image = torch.zeros(view.height, view.width, 3, dtype=torch.uint8)
    if edges:
        image[:, 2::4] = image[:, 3::4] = 255
    return regularizers.roughness(regularizers.Depths.of(points, view, 0.1), image, 30.0)


def test_roughness_is_zero_for_tilted_planes() -> None:
    assert rough(0.0) < 1e-4
    leaning, bent = rough(0.0, 0.004), rough(0.01)
    assert leaning < 0.3 * bent, "all that bends is its steps from splat to splat"
    assert rough(0.02) > 1.5 * bent


def test_roughness_is_smaller_at_image_edges() -> None:
    assert rough(0.02, edges=True) < 0.2 * rough(0.02)


def test_roughness_fades_plate_in_front_of_plain_wall() -> None:
    points, view, opacities = corrugated(0.0)
    near = torch.zeros(len(opacities), dtype=torch.bool)
    near[len(opacities) // 2 + 8 : len(opacities) // 2 + 14] = (
        True  # a few in the middle of a row, at half the distance
    )
    lifted = points._replace(depths=torch.where(near, points.depths / 2, points.depths))
    regularizers.roughness(
        regularizers.Depths.of(lifted, view, 0.1), torch.zeros(32, 48, 3, dtype=torch.uint8), 30.0
    ).backward()
    assert opacities.grad is not None
    assert opacities.grad[near].sum() > 0
    assert opacities.grad[near].mean() > 5 * opacities.grad[~near].mean()
