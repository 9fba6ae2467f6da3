"""Projection compared with the twin, with gsplat's reference and with known answers."""

# pyright: reportCallIssue=false
# Pyright assumes that an unpacked list fills all remaining positional arguments.

import numpy as np
import pytest
import torch

from splatreel.base.errors import GaussiansError
from splatreel.kernels import splat, twin
from tests.kernels.compare import assert_parity, camera, gaussians

W, H = 37, 29


@pytest.mark.parametrize("antialias", [False, True])
@pytest.mark.parametrize("distance", [3.0, 0.5])  # at 0.5 many points are behind the camera or far outside the view
def test_project_equals_twin(distance, antialias):
    viewmat, K = camera(W, H, distance)
    means, quats, scales, *_ = gaussians(300)
    assert_parity(
        lambda *a: splat.project(*a, viewmat, K, W, H, 0.2, antialias),
        lambda *a: twin.project(*a, viewmat, K, W, H, 0.2, antialias),
        [means, quats, scales],
    )
    radii = splat.project(means, quats, scales, viewmat, K, W, H, 0.2, antialias).radii
    assert torch.equal(radii, twin.project(means, quats, scales, viewmat, K, W, H, 0.2, antialias).radii)
    assert 0 < (radii > 0).sum() < 300


def test_point_on_axis_projects_to_principal_point():
    K = np.array([[100, 0, 20], [0, 100, 15], [0, 0, 1]])
    point = (torch.tensor([[0.0, 0, 2]]), torch.tensor([[1.0, 0, 0, 0]]), torch.full((1, 3), 0.02))
    projection = splat.project(*point, np.eye(4), K, 40, 30)
    assert projection.means2d[0].tolist() == [20, 15]
    variance = (100 * 0.02 / 2) ** 2 + 0.3
    torch.testing.assert_close(projection.conics[0], torch.tensor([1 / variance, 0, 1 / variance]))
    assert projection.depths[0] == 2
    assert projection.radii[0] == np.ceil(3.33 * variance**0.5)


@pytest.mark.parametrize("mean", [(0.0, 0, -2), (0, 0, 0.005), (50, 0, 1)])
def test_invisible_point_is_culled_without_gradient(mean):
    means = torch.tensor([mean]).float().requires_grad_()
    projection = splat.project(means, torch.ones(1, 4), torch.full((1, 3), 0.1), np.eye(4), camera(W, H)[1], W, H)
    assert projection.radii[0] == 0
    (projection.means2d.sum() + projection.conics.sum() + projection.depths.sum()).backward()
    assert means.grad is not None
    assert not means.grad.any()


def test_quaternion_scale_has_no_effect():
    viewmat, K = camera(W, H)
    means, quats, scales, *_ = gaussians(50)
    a = splat.project(means, quats, scales, viewmat, K, W, H)
    b = splat.project(means, quats * 7, scales, viewmat, K, W, H)
    torch.testing.assert_close(a.conics, b.conics)


@pytest.mark.parametrize("index", [0, 1, 2])
@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_project_rejects_nan(index, value):
    inputs = gaussians(5)[:3]
    inputs[index][2, 1] = value
    with pytest.raises(GaussiansError, match="1 values"):
        splat.project(*inputs, *camera(W, H), W, H)


def test_project_accepts_huge_finite_values():
    means, quats, scales = gaussians(5)[:3]
    means[0] = 3e38
    means[1] = 3e38  # the sum overflows
    splat.project(means, quats, scales, *camera(W, H), W, H)


def test_project_equals_gsplat():
    reference = pytest.importorskip("gsplat.cuda._torch_impl", reason="gsplat is not installed")
    viewmat, K = camera(W, H)
    means, quats, scales, *_ = gaussians(300)
    pose, lens = torch.from_numpy(viewmat)[None], torch.from_numpy(K)[None]
    covars, _ = reference._quat_scale_to_covar_preci(torch.nn.functional.normalize(quats, dim=-1), scales, True, False)
    radii, means2d, depths, conics, _ = reference._fully_fused_projection(
        means, covars, pose, lens, W, H, near_plane=0.2
    )
    ours = splat.project(means, quats, scales, viewmat, K, W, H, 0.2)
    seen = ours.radii > 0
    assert torch.equal(seen, (radii[0] > 0).all(-1))
    assert torch.equal(ours.radii, radii[0].amax(-1).int())
    torch.testing.assert_close(ours.means2d[seen], means2d[0][seen], rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(ours.conics[seen], conics[0][seen], rtol=1e-3, atol=1e-5)
    torch.testing.assert_close(ours.depths[seen], depths[0][seen])
