"""Whole renders and nearest neighbours."""

import pytest
import torch

from splatreel.errors import GaussiansError
from splatreel.kernels import splat, twin
from tests.kernels.compare import assert_parity, camera, gaussians

W, H = 45, 33


def twin_render(means, quats, scales, opacities, sh, viewmat, K):
    means2d, conics, depths, radii = twin.project(means, quats, scales, viewmat, K, W, H)
    pose = torch.as_tensor(viewmat, dtype=means.dtype)
    directions = means + pose[:3, :3].T @ pose[:3, 3]
    colors = (twin.spherical_harmonics(round(sh.shape[1] ** 0.5) - 1, directions, sh) + 0.5).clamp_min(0)
    return twin.rasterize(means2d, conics, colors, opacities, depths, radii, W, H)


@pytest.mark.parametrize("bands", [1, 16])
def test_parity_of_a_whole_render(bands):
    viewmat, K = camera(W, H)
    assert_parity(
        lambda *a: tuple(splat.render(*a, viewmat, K, W, H)[:2]),
        lambda *a: twin_render(*a, viewmat, K),
        gaussians(150, bands),
        1e-4,
    )


def test_screen_gradients_can_be_kept():
    viewmat, K = camera(W, H)
    means, *rest = gaussians(50)
    rendered = splat.render(means.requires_grad_(), *rest, torch.from_numpy(viewmat), torch.from_numpy(K), W, H)
    rendered.means2d.retain_grad()
    rendered.image.sum().backward()
    assert rendered.means2d.grad is not None
    assert rendered.means2d.grad.shape == (50, 2)
    assert rendered.means2d.grad[rendered.radii > 0].any()
    assert not rendered.means2d.grad[rendered.radii == 0].any()


def test_lower_degree_ignores_the_higher_bands():
    viewmat, K = camera(W, H)
    means, quats, scales, opacities, sh = gaussians(50)
    low = splat.render(means, quats, scales, opacities, sh, viewmat, K, W, H, degree=1).image
    torch.testing.assert_close(low, splat.render(means, quats, scales, opacities, sh[:, :4], viewmat, K, W, H).image)


@pytest.mark.parametrize("name", ["opacities", "sh"])
def test_nan_is_refused(name):
    scene = dict(zip(("means", "quats", "scales", "opacities", "sh"), gaussians(5), strict=True))
    scene[name].view(-1)[0] = float("nan")
    with pytest.raises(GaussiansError, match="NaN"):
        splat.render(*scene.values(), *camera(W, H), W, H)


@pytest.mark.parametrize("k", [1, 5])
@pytest.mark.parametrize("asked", [True, False])
def test_neighbours_equal_brute_force(k, asked):
    generator = torch.Generator().manual_seed(0)
    points = torch.rand(200, 3, generator=generator)
    queries = torch.rand(30, 3, generator=generator) if asked else None
    indices, distances = splat.nearest_neighbours(points, k, queries)
    expected_indices, expected_distances = twin.nearest_neighbours(points, k, queries)
    assert torch.equal(indices, expected_indices)
    assert indices.dtype == torch.int64
    torch.testing.assert_close(distances, expected_distances)


def test_coinciding_points_are_each_others_neighbours():
    points = torch.zeros(4, 3)
    indices, distances = splat.nearest_neighbours(points, 2)
    assert indices.shape == (4, 2)
    assert not (indices == torch.arange(4)[:, None]).any()
    assert not distances.any()


@pytest.mark.parametrize("k", [0, 4])
def test_too_many_neighbours_are_refused(k):
    with pytest.raises(GaussiansError, match="there are 3"):
        splat.nearest_neighbours(torch.zeros(4, 3), k)
