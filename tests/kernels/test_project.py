"""Projection: known answers, and gsplat's reference."""

import numpy as np
import pytest

from splatreel.base.errors import GaussiansError
from splatreel.kernels import project, splat
from tests.kernels.compare import camera, floats, gaussians

W, H = 37, 29


@pytest.mark.parametrize("distance", [3.0, 0.5])
def test_some_points_are_visible(distance):
    """The recorded cases hold points that are behind the camera or far outside the view, and points that are not."""
    means, quats, scales, *_ = gaussians(120)
    radii = splat.project(means, quats, scales, *camera(W, H, distance), W, H, 0.2).radii
    assert 0 < (radii > 0).sum() < 120


def test_point_on_axis_projects_to_principal_point():
    K = np.array([[100, 0, 20], [0, 100, 15], [0, 0, 1]])
    point = floats([[0, 0, 2]]), floats([[1, 0, 0, 0]]), np.full((1, 3), 0.02, np.float32)
    projection = splat.project(*point, np.eye(4), K, 40, 30)
    assert projection.means2d[0].tolist() == [20, 15]
    variance = (100 * 0.02 / 2) ** 2 + 0.3
    np.testing.assert_allclose(projection.conics[0], [1 / variance, 0, 1 / variance], rtol=1e-6)
    assert projection.depths[0] == 2
    assert projection.radii[0] == np.ceil(3.33 * variance**0.5)


@pytest.mark.parametrize("mean", [(0.0, 0, -2), (0, 0, 0.005), (50, 0, 1)])
def test_invisible_point_is_culled_without_gradient(mean):
    points = floats([mean]), np.ones((1, 4), np.float32), np.full((1, 3), 0.1, np.float32)
    view = project.Pinhole(np.eye(4, dtype=np.float32), camera(W, H)[1], W, H, 0.01)
    means2d, conics, depths, radii = project.forward(*points, view)
    assert radii[0] == 0
    ones = np.ones_like(means2d), np.ones_like(conics), np.ones_like(depths)
    for gradient in project.backward(*points, conics, *ones, radii=radii, view=view):
        assert not gradient.any()


def test_quaternion_scale_has_no_effect():
    means, quats, scales, *_ = gaussians(50)
    a = splat.project(means, quats, scales, *camera(W, H), W, H)
    b = splat.project(means, quats * 7, scales, *camera(W, H), W, H)
    np.testing.assert_allclose(a.conics, b.conics, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("index", [0, 1, 2])
@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_project_rejects_nan(index, value):
    means, quats, scales, *_ = gaussians(5)
    (means, quats, scales)[index][2, 1] = value
    with pytest.raises(GaussiansError, match="1 values"):
        splat.project(means, quats, scales, *camera(W, H), W, H)


def test_project_accepts_huge_finite_values():
    means, quats, scales, *_ = gaussians(5)
    means[:2] = 3e38  # the sum overflows
    splat.project(means, quats, scales, *camera(W, H), W, H)


@pytest.mark.oracle
def test_project_equals_gsplat():
    torch = pytest.importorskip("torch")
    reference = pytest.importorskip("gsplat.cuda._torch_impl", reason="gsplat is not installed")
    viewmat, K = camera(W, H)
    means, quats, scales, *_ = gaussians(300)
    pose, lens = torch.from_numpy(viewmat)[None], torch.from_numpy(K)[None]
    turns = torch.nn.functional.normalize(torch.from_numpy(quats), dim=-1)
    covars, _ = reference._quat_scale_to_covar_preci(turns, torch.from_numpy(scales), True, False)
    found = reference._fully_fused_projection(torch.from_numpy(means), covars, pose, lens, W, H, near_plane=0.2)
    radii, means2d, depths, conics = (tensor[0].numpy() for tensor in found[:4])
    ours = splat.project(means, quats, scales, viewmat, K, W, H, 0.2)
    seen = ours.radii > 0
    np.testing.assert_array_equal(seen, (radii > 0).all(-1))
    np.testing.assert_array_equal(ours.radii, radii.max(-1))
    np.testing.assert_allclose(ours.means2d[seen], means2d[seen], rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(ours.conics[seen], conics[seen], rtol=1e-3, atol=1e-5)
    np.testing.assert_allclose(ours.depths[seen], depths[seen], rtol=1e-5)
