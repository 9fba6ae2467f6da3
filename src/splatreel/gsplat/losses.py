"""Losses as differentiable functions of tensors: the photometric loss, surfaces of keyframes, and rigidity of motion."""

from __future__ import annotations

from functools import cache

import torch
import torch.nn.functional as functional
from torch import Tensor

from splatreel.gsplat.drawing import Lens, Splats, rasterize
from splatreel.kernels.similarity import SSIM_C1, SSIM_C2, WINDOW
from splatreel.method.train.terms.depths import MIN_ALPHA
from splatreel.method.train.terms.surfaces import EDGE_CONTRAST, MAX_SEPARATION, MIN_VARIANCE


def photometric(image: Tensor, target: Tensor, lambda_dssim: float, gain: Tensor | None) -> Tensor:
    """Return the photometric loss of 3DGS of an image [H, W, 3] against a target, uint8. gain: [3]; None is 1."""
    if gain is not None:
        image = image * gain
    x, y = image.permute(2, 0, 1), target.to(image.dtype).permute(2, 0, 1) / 255
    mx, my, xx, yy, xy = _blur(torch.stack([x, y, x * x, y * y, x * y]))
    vx, vy, covariance = xx - mx * mx, yy - my * my, xy - mx * my
    c1, c2 = float(SSIM_C1), float(SSIM_C2)
    ssim = (2 * mx * my + c1) * (2 * covariance + c2) / ((mx * mx + my * my + c1) * (vx + vy + c2))
    return (1 - lambda_dssim) * (x - y).abs().mean() + lambda_dssim * (1 - ssim.mean())


def _blur(maps: Tensor) -> Tensor:
    """Blur maps [M, 3, H, W] with the SSIM window, zeros outside."""
    flat, window = maps.reshape(-1, 1, *maps.shape[-2:]), _window(maps.device)
    across = functional.conv2d(flat, window.view(1, 1, 1, -1), padding=(0, len(window) // 2))
    return functional.conv2d(across, window.view(1, 1, -1, 1), padding=(len(window) // 2, 0)).view(maps.shape)


@cache
def _window(device: torch.device) -> Tensor:
    """Return the SSIM window [11], copied once, since a copy waits for the GPU."""
    return torch.as_tensor(WINDOW, dtype=torch.float32, device=device)


def surfaces(
    splats: Splats, lens: Lens, near: float, image: Tensor, spread: float, roughness: float, span: float
) -> Tensor:
    """Return the weighted losses of surfaces, see `method.train.terms.surfaces`. Only opacities get gradients.

    Args:
        splats: Projected points.
        lens: View.
        near: Near plane, world units.
        image: [H, W, 3] uint8 target.
        spread: Weight of points in front of surfaces.
        roughness: Weight of bends in depth.
        span: Typical viewing distance in multiples of the near plane.
    """
    depth = (splats.depths.clamp_min(near) / near).log()
    sums, alpha = rasterize(splats._replace(colors=torch.stack([depth, depth.square(), depth**3], 1)), lens)
    first, second, third = (sums / alpha.clamp_min(MIN_ALPHA)[..., None]).unbind(-1)
    cost = torch.zeros((), device=alpha.device)
    if spread:
        with torch.no_grad():
            variance = (second - first.square()).clamp_min(MIN_VARIANCE)
            skewness = (third - 3 * first * variance - first**3) / variance**1.5
            root = (skewness.square() + 4).sqrt()
            far = first + variance.sqrt() * (skewness + root) / 2
            share = (root - skewness) / (2 * root)
            weight = alpha * share.square() * (MAX_SEPARATION**2 / (variance * root.square())).clamp_max(1)
        cost = cost + spread * (weight * (second - 2 * far * first + far.square())).mean()
    if roughness:
        cost = cost + roughness * _bends(span * (-first).exp(), image.float() / 255)
    return cost


def _bends(inverse: Tensor, colors: Tensor) -> Tensor:
    """Return the mean second difference of inverse depths [H, W] along rows and columns, less where colors [H, W, 3] differ."""
    cost = inverse.new_zeros(())
    for along in (0, 1):
        before, here, after = (inverse.narrow(along, k, inverse.shape[along] - 2) for k in range(3))
        first, last = (colors.narrow(along, k, inverse.shape[along] - 2) for k in (0, 2))
        plain = torch.exp((last - first).abs().amax(-1) / -EDGE_CONTRAST)
        cost = cost + (plain * (before - 2 * here + after).abs()).mean()
    return cost


def rigidity(means: Tensor, dx: Tensor, dq: Tensor, neighbor: Tensor, weights: Tensor, unit: float) -> Tensor:
    """Return the as-rigid-as-possible loss of every point with one neighbor, see `kernels.motion.arap`."""
    half = (means - means[neighbor]).detach() / 2
    dq, rotation = functional.normalize(dq, dim=-1), _rotation(dq)
    rotated = ((rotation + rotation[neighbor]) @ half[..., None])[..., 0]
    apart = 2 * half + dx - dx[neighbor]
    shift = apart - rotated
    stretch = 2 * half.norm(dim=1) - apart.square().sum(1).add(1e-12).sqrt()
    turned = (dq - dq[neighbor]).abs().sum(1)
    return (weights * (turned + (shift.abs().sum(1) + stretch.abs()) / unit)).mean()


def _rotation(quats: Tensor) -> Tensor:
    w, x, y, z = functional.normalize(quats, dim=-1).unbind(-1)
    rows = [
        torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
        torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
        torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1),
    ]
    return torch.stack(rows, -2)
