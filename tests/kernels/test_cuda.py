"""The CUDA backend compared with the twin. These tests skip without a GPU or gsplat."""

# pyright: reportCallIssue=false
# Pyright assumes that an unpacked list fills all remaining positional arguments.

import sys

import pytest
import torch

from splatreel.base.errors import MissingDependencyError
from splatreel.kernels import cuda_backend as cuda
from splatreel.kernels import splat, twin
from splatreel.kernels.splat import Splats
from tests.kernels.compare import camera, gaussians, splats

needs_cuda = pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device: the gsplat path was not tested")


def test_missing_gsplat_error_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "gsplat", None)
    with pytest.raises(MissingDependencyError, match=r"splatreel\[cuda\]"):
        cuda.CudaBackend().spherical_harmonics(0, torch.zeros(1, 3), torch.zeros(1, 1, 3))


@pytest.mark.cuda
@needs_cuda
@pytest.mark.parametrize("channels", [1, 3, 5])
def test_rasterize_parity(channels):
    pytest.importorskip("gsplat")
    inputs = splats(150, channels, 40, 30)
    inputs.radii.mul_(64)  # gsplat bins by radius
    compare(lambda *a: splat.rasterize(Splats(*a), 40, 30), lambda *a: twin.rasterize(Splats(*a), 40, 30), inputs, 4)


@pytest.mark.cuda
@needs_cuda
def test_render_parity():
    pytest.importorskip("gsplat")
    view = (*camera(45, 33), 45, 33)
    compare(lambda *a: splat.render(*a, *view)[:2], lambda *a: splat.render(*a, *view)[:2], gaussians(150), 5)


@pytest.mark.cuda
@needs_cuda
def test_project_parity():
    pytest.importorskip("gsplat")
    view = (*camera(37, 29), 37, 29)
    compare(lambda *a: splat.project(*a, *view)[:3], lambda *a: twin.project(*a, *view)[:3], gaussians(300)[:3], 3)


def compare(on_gpu, on_cpu, inputs, leaves):
    """Assert that both devices give the same outputs and the same gradients to the first `leaves` inputs."""
    gpu = [t.cuda().requires_grad_(i < leaves) for i, t in enumerate(inputs)]
    cpu = [t.clone().requires_grad_(i < leaves) for i, t in enumerate(inputs)]
    for a, b in zip(on_gpu(*gpu), on_cpu(*cpu), strict=True):
        torch.testing.assert_close(a.cpu(), b, atol=2e-4, rtol=1e-3)
        b.square().sum().backward(retain_graph=True)
        a.square().sum().backward(retain_graph=True)
    for a, b in zip(gpu[:leaves], cpu[:leaves], strict=True):
        assert a.grad is not None
        assert b.grad is not None
        error = (a.grad.cpu() - b.grad).abs().max() / b.grad.abs().max()
        assert float(error) < 1e-3
