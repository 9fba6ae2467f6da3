"""Complete renders, antialiasing and nearest neighbors."""

# pyright: reportCallIssue=false
# Pyright assumes that an unpacked list fills all remaining positional arguments.

import math

import numpy as np
import pytest
import torch

from splatreel.base.errors import GaussiansError
from splatreel.kernels import splat, twin
from splatreel.kernels.image import render_image
from splatreel.scene import rotations
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians
from tests.kernels.compare import assert_parity, camera, gaussians

W, H = 45, 33


def twin_render(means, quats, scales, opacities, sh, viewmat, K):
    projection = twin.project(means, quats, scales, viewmat, K, W, H)
    pose = torch.as_tensor(viewmat, dtype=means.dtype)
    directions = means + pose[:3, :3].T @ pose[:3, 3]
    colors = (twin.spherical_harmonics(round(sh.shape[1] ** 0.5) - 1, directions, sh) + 0.5).clamp_min(0)
    return twin.rasterize(projection.colored(colors, opacities), W, H)


@pytest.mark.parametrize("bands", [1, 16])
def test_render_equals_twin(bands):
    viewmat, K = camera(W, H)
    assert_parity(
        lambda *a: tuple(splat.render(*a, viewmat, K, W, H)[:2]),
        lambda *a: twin_render(*a, viewmat, K),
        gaussians(150, bands),
        1e-4,
    )


def test_render_retains_screen_gradients():
    viewmat, K = camera(W, H)
    means, *rest = gaussians(50)
    rendered = splat.render(means.requires_grad_(), *rest, torch.from_numpy(viewmat), torch.from_numpy(K), W, H)
    rendered.means2d.retain_grad()
    rendered.image.sum().backward()
    assert rendered.means2d.grad is not None
    assert rendered.means2d.grad.shape == (50, 2)
    assert rendered.means2d.grad[rendered.radii > 0].any()
    assert not rendered.means2d.grad[rendered.radii == 0].any()


def test_render_at_lower_degree_ignores_higher_bands():
    viewmat, K = camera(W, H)
    means, quats, scales, opacities, sh = gaussians(50)
    low = splat.render(means, quats, scales, opacities, sh, viewmat, K, W, H, degree=1).image
    torch.testing.assert_close(low, splat.render(means, quats, scales, opacities, sh[:, :4], viewmat, K, W, H).image)


@pytest.mark.parametrize("name", ["opacities", "sh"])
def test_render_rejects_nan(name):
    scene = dict(zip(("means", "quats", "scales", "opacities", "sh"), gaussians(5), strict=True))
    scene[name].view(-1)[0] = float("nan")
    with pytest.raises(GaussiansError, match="NaN"):
        splat.render(*scene.values(), *camera(W, H), W, H)


@pytest.mark.parametrize("k", [1, 5])
@pytest.mark.parametrize("asked", [True, False])
def test_nearest_neighbors_equal_brute_force(k, asked):
    generator = torch.Generator().manual_seed(0)
    points = torch.rand(200, 3, generator=generator)
    queries = torch.rand(30, 3, generator=generator) if asked else None
    indices, distances = splat.nearest_neighbors(points, k, queries)
    expected_indices, expected_distances = twin.nearest_neighbors(points, k, queries)
    assert torch.equal(indices, expected_indices)
    assert indices.dtype == torch.int64
    torch.testing.assert_close(distances, expected_distances)


def test_nearest_neighbors_include_coinciding_points():
    points = torch.zeros(4, 3)
    indices, distances = splat.nearest_neighbors(points, 2)
    assert indices.shape == (4, 2)
    assert not (indices == torch.arange(4)[:, None]).any()
    assert not distances.any()


@pytest.mark.parametrize("k", [0, 4])
def test_nearest_neighbors_rejects_wrong_k(k):
    with pytest.raises(GaussiansError, match="there are 3"):
        splat.nearest_neighbors(torch.zeros(4, 3), k)


def test_antialiased_opacity_falls_by_blurred_area():
    long, wide, angle = 4.0, 0.05, 0.6
    turn = torch.tensor([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    blurred = turn @ torch.diag(torch.tensor([long + 0.1, wide + 0.1])) @ turn.T
    inverse = torch.linalg.inv(blurred)
    conics = torch.stack([inverse[0, 0], inverse[0, 1], inverse[1, 1]])[None]
    expected = math.sqrt(long * wide / ((long + 0.1) * (wide + 0.1)))
    torch.testing.assert_close(splat.antialiased(torch.tensor([0.8]), conics), torch.tensor([0.8 * expected]))
    culled = splat.antialiased(torch.tensor([0.8]), torch.zeros(1, 3))
    torch.testing.assert_close(culled, torch.tensor([0.8]))


def test_antialiased_gradients_equal_finite_differences():
    viewmat, K = camera(W, H)
    points = [tensor.double() for tensor in gaussians(4, 1)]
    points[2] = points[2] * 0.05  # thin Gaussians, of which the blur is the larger part
    points[2].requires_grad_()

    def opacities(scales):
        projection = twin.project(points[0], points[1], scales, viewmat, K, W, H, antialias=True)
        return splat.antialiased(points[3], projection.conics)

    assert torch.autograd.gradcheck(opacities, (points[2],), eps=1e-7, atol=1e-4)


def test_half_size_image_matches_only_with_antialias():
    rng = np.random.default_rng(0)
    count = 400
    points = Gaussians(
        means=np.concatenate([rng.uniform(-1, 1, (count, 2)), np.zeros((count, 1))], 1),
        quats=rotations.normalize(rng.normal(size=(count, 4))),
        scales=np.full((count, 3), 0.008),
        opacities=np.full(count, 0.9),
        sh=rng.uniform(0, 1.5, (count, 1, 3)),
    )

    def drawn(size, antialias):
        K = np.array([[size, 0, size / 2], [0, size, size / 2], [0, 0, 1]], np.float32)
        viewmat = np.eye(4, dtype=np.float32)
        viewmat[2, 3] = 2
        return render_image(points, Camera("c", viewmat, K, size, size), antialias=antialias)

    def difference(antialias):
        return np.abs(drawn(128, antialias).reshape(64, 2, 64, 2, 3).mean((1, 3)) - drawn(64, antialias)).mean()

    assert difference(True) < 0.4 * difference(False)
    assert drawn(64, True).mean() < 0.7 * drawn(64, False).mean()


@pytest.mark.parametrize("antialias", [False, True])
def test_render_image_equals_render(antialias):
    viewmat, K = camera(W, H)
    tensors = gaussians(80, 4)
    image = splat.render(*tensors, viewmat, K, W, H, antialias=antialias).image
    means, quats, scales, opacities, sh = (t.numpy() for t in tensors)
    same = render_image(
        Gaussians(means, quats, scales, opacities, sh), Camera("c", viewmat, K, W, H), antialias=antialias
    )
    np.testing.assert_allclose(image.numpy(), same, atol=1e-5)
