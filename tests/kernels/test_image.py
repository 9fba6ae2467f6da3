"""Rendering Gaussians to an image."""

import numpy as np
import pytest

from splatreel.base.errors import GaussiansError
from splatreel.kernels import harmonics, splat
from splatreel.kernels.image import Backdrop, render_image
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians
from tests.kernels.compare import camera, floats, gaussians

W, H = 45, 33
CAMERA = Camera("test", *camera(W, H), W, H)


def cloud(n: int = 100, bands: int = 16) -> Gaussians:
    means, quats, scales, opacities, sh = gaussians(n, bands)
    return Gaussians(means, quats, scales, opacities, sh)


@pytest.mark.parametrize("antialias", [False, True])
@pytest.mark.parametrize("degree", [None, 1])
def test_image_is_that_of_the_kernels(degree, antialias):
    scene = cloud()
    shapes = scene.means, scene.quats, scene.scales
    projected = splat.project(*shapes, CAMERA.viewmat, CAMERA.K, W, H, antialias=antialias)
    colors = np.maximum(
        harmonics.forward(3 if degree is None else degree, scene.means - CAMERA.center, scene.sh) + 0.5, 0
    )
    opacities = splat.antialiased(scene.opacities, projected.conics) if antialias else scene.opacities
    expected, alpha = splat.rasterize(projected.colored(colors, opacities), W, H)
    image = render_image(scene, CAMERA, degree=degree, antialias=antialias)
    assert image.dtype == np.float32
    np.testing.assert_allclose(image, expected, atol=1e-6)
    behind = floats([0.1, 0.2, 0.3])
    image = render_image(scene, CAMERA, degree=degree, antialias=antialias, background=(0.1, 0.2, 0.3))
    np.testing.assert_allclose(image, expected + (1 - alpha[..., None]) * behind, atol=1e-6)


def test_image_of_lower_degree_leaves_out_higher_bands():
    scene, low = cloud(), cloud()
    low.sh[:, 4:] = 0
    np.testing.assert_allclose(render_image(scene, CAMERA, degree=1), render_image(low, CAMERA), atol=1e-6)


def test_image_of_nothing_is_the_background():
    empty = render_image(Gaussians.empty(), CAMERA, background=(0.1, 0.2, 0.3))
    np.testing.assert_allclose(empty, np.broadcast_to(np.array([0.1, 0.2, 0.3], np.float32), (H, W, 3)))


@pytest.mark.parametrize("antialias", [False, True])
def test_backdrop_with_others_equals_rendering_everything(antialias):
    scene, how = cloud(), {"antialias": antialias, "background": (0.1, 0.2, 0.3)}
    order = np.random.default_rng(0).permutation(100)
    backdrop = Backdrop(scene[order[:60]], CAMERA, **how)
    for others in (scene[order[60:]], scene[order[60:70]], scene[order[:0]]):
        expected = render_image(Gaussians.concatenate([scene[order[:60]], others]), CAMERA, **how)
        np.testing.assert_allclose(backdrop.with_others(others), expected, atol=1e-6)


def test_render_image_rejects_nan():
    scene = cloud()
    scene.means[3, 0] = np.nan
    with pytest.raises(GaussiansError, match="means"):
        render_image(scene, CAMERA)


def test_render_image_rejects_too_high_degree():
    with pytest.raises(GaussiansError, match="degree 4"):
        render_image(cloud(), CAMERA, degree=4)
