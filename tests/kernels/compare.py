"""Comparison of a kernel with its twin: same inputs, equal results and gradients."""

from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor

from splatreel.kernels.splat import Splats

Outputs = Tensor | tuple[Tensor, ...]


def assert_parity(
    fast: Callable[..., Outputs], slow: Callable[..., Outputs], inputs: Sequence[Tensor], tolerance: float = 1e-5
) -> None:
    """Assert that `fast` in float32 equals `slow` in float64: all outputs and gradients, relative to the largest value."""
    singles = [tensor.clone().requires_grad_() for tensor in inputs]
    doubles = [tensor.double().requires_grad_() for tensor in inputs]
    fast_outputs, slow_outputs = _floats(fast(*singles)), _floats(slow(*doubles))
    assert len(fast_outputs) == len(slow_outputs)
    for index, (a, b) in enumerate(zip(fast_outputs, slow_outputs, strict=True)):
        assert_close(a, b, tolerance, f"output {index}")
    generator = torch.Generator().manual_seed(1)
    weights = [torch.randn(output.shape, generator=generator) for output in fast_outputs]
    torch.autograd.backward(fast_outputs, weights)
    torch.autograd.backward(slow_outputs, [weight.double() for weight in weights])
    for index, (a, b) in enumerate(zip(singles, doubles, strict=True)):
        assert (a.grad is None) == (b.grad is None)
        if a.grad is not None and b.grad is not None:
            assert_close(a.grad, b.grad, tolerance, f"gradient to input {index}")


def assert_close(a: Tensor, b: Tensor, tolerance: float, what: str) -> None:
    assert a.shape == b.shape, what
    if a.numel():
        error = float((a.detach().double() - b.detach()).abs().max())
        assert error <= tolerance * max(float(b.detach().abs().max()), 1e-6), f"{what}: off by {error}"


def splats(n: int, channels: int, width: int, height: int, seed: int = 0) -> Splats:
    """Return splats. Some are off the image, at equal depth, or culled."""
    rng = np.random.default_rng(seed)
    means2d = rng.uniform(-6, 6, (n, 2)) + rng.uniform(0, 1, (n, 2)) * [width, height]
    half = rng.normal(0, 2.5, (n, 2, 2))
    conics = np.linalg.inv(half @ half.transpose(0, 2, 1) + 0.3 * np.eye(2))[:, [0, 0, 1], [0, 1, 1]]
    depths = np.round(rng.uniform(1, 5, n), 1)
    radii = (rng.uniform(size=n) > 0.1).astype(np.int32)
    arrays = means2d, conics, rng.uniform(0, 1, (n, channels)), rng.uniform(0, 1, n), depths
    means2d, conics, colors, opacities, depths = (torch.from_numpy(array.astype(np.float32)) for array in arrays)
    return Splats(means2d, conics, colors, opacities, depths, torch.from_numpy(radii))


def gaussians(n: int, bands: int = 16, seed: int = 0) -> list[Tensor]:
    """Return means, quats (not normalized), scales, opacities and sh of Gaussians around the origin."""
    g = torch.Generator().manual_seed(seed)
    scales, opacities = torch.rand(n, 3, generator=g) * 0.3 + 0.02, torch.rand(n, generator=g)
    means, quats, sh = (torch.randn(*shape, generator=g) for shape in ((n, 3), (n, 4), (n, bands, 3)))
    return [means * 1.2, quats, scales, opacities, sh * 0.3]


def camera(width: int, height: int, distance: float = 3.0) -> tuple[np.ndarray, np.ndarray]:
    """Return viewmat and K of a camera in general position, with its principal point off the center."""
    rotation = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    viewmat = np.eye(4)
    viewmat[:3, :3] = rotation * np.sign(np.linalg.det(rotation))
    viewmat[:3, 3] = (0.1, 0.2, distance)
    K = np.array([[1.1 * width, 0, width / 2 + 2], [0, 1.2 * width, height / 2 - 1], [0, 0, 1]])
    return viewmat.astype(np.float32), K.astype(np.float32)


def _floats(outputs: Outputs) -> list[Tensor]:
    parts = outputs if isinstance(outputs, tuple) else (outputs,)
    return [part for part in parts if part.is_floating_point()]
