"""Rendering to numpy without torch."""

# pyright: reportCallIssue=false
# Pyright assumes that an unpacked list fills all remaining positional arguments.

import subprocess
import sys

import numpy as np
import pytest
import torch

from splatreel.base.errors import GaussiansError
from splatreel.kernels import splat
from splatreel.kernels.image import Backdrop, render_image
from splatreel.scene.camera import Camera
from splatreel.scene.gaussians import Gaussians
from tests.kernels.compare import camera, gaussians

W, H = 45, 33
CAMERA = Camera("test", *camera(W, H), W, H)


def cloud(n: int = 100) -> Gaussians:
    return Gaussians(*(tensor.numpy() for tensor in gaussians(n)))


@pytest.mark.parametrize("degree", [None, 1])
def test_render_image_equals_torch_render(degree):
    scene = cloud()
    expected = splat.render(*gaussians(100), CAMERA.viewmat, CAMERA.K, W, H, degree=degree).image
    image = render_image(scene, CAMERA, degree=degree)
    assert image.dtype == np.float32
    np.testing.assert_allclose(image, expected.numpy(), atol=1e-6)


def test_render_image_shows_background():
    empty = render_image(Gaussians.empty(), CAMERA, background=(0.1, 0.2, 0.3))
    np.testing.assert_allclose(empty, np.broadcast_to(np.array([0.1, 0.2, 0.3], np.float32), (H, W, 3)))
    rendered = splat.render(*gaussians(100), CAMERA.viewmat, CAMERA.K, W, H)
    expected = rendered.image + (1 - rendered.alpha[..., None]) * torch.tensor([0.1, 0.2, 0.3])
    np.testing.assert_allclose(render_image(cloud(), CAMERA, background=(0.1, 0.2, 0.3)), expected.numpy(), atol=1e-6)


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


def test_render_image_does_not_import_torch():
    program = "import sys; import splatreel.kernels.image; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
