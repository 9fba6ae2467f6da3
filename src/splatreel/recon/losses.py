"""Regularisers: of groups (paper section 4.2), as rigid as possible and smooth in time; of keyframes, nothing before a surface."""

from __future__ import annotations

import torch
from torch import Tensor

from splatreel.kernels import splat
from splatreel.recon.deformation import Deformation
from splatreel.recon.drawing import Splats, View

CLEAR = 1e-3
"""Alpha below which a pixel shows nothing that could be apart."""


def arap(means: Tensor, dx: Tensor, dq: Tensor, neighbour: Tensor, weights: Tensor, unit: float) -> Tensor:
    """L_arap: neighbours rotate alike, translate alike and keep their distance.

    means, dx: [N, 3]; dq: [N, 4]; neighbour: [N] a neighbour of every point; weights: [N], one where points coincide. Lengths are
    measured in `unit`, so that the loss means the same in millimetres and in metres. Only the offsets get gradients. Mean over points.
    """
    return splat.arap(means.detach(), dx, dq, neighbour, weights, unit)


def temporal(model: Deformation, means: Tensor, frame: float, other: float, delta: float, unit: float) -> Tensor:
    """L_temp: between two close frames, offsets are linear in time.

    The last term of the printed formula mixes an offset with a position; it is read as the offset at frame + delta (other - frame).
    Mean over the points.
    """
    dx0, dq0 = model.offsets(means, frame)
    dx1, dq1 = model.offsets(means, other)
    dx, dq = model.offsets(means, frame + delta * (other - frame))
    position = ((1 - delta) * dx0 + delta * dx1 - dx).abs().sum(1) / unit
    rotation = ((1 - delta) * dq0 + delta * dq1 - dq).abs().sum(1)
    return (position + rotation).mean()


def spread(points: Splats, view: View, near: float) -> Tensor:
    """How far apart the points are that a pixel shows: the variance of their log depths, as they are blended; mean over pixels.

    A surface has next to none, a floater before it has. It is the distortion loss of Mip-NeRF 360 (Barron et al. 2022, equation 15)
    with squares, which take one pass, in place of absolute distances. Depths get no gradient: what is apart shall fade and not move.
    Log depths mean the same in millimetres and in metres.
    """
    depth = (points.depths.detach().clamp_min(near) / near).log()
    moments = torch.stack([depth, depth.square()], 1)
    size = view.width, view.height
    sums, alpha = splat.rasterize(
        points.means2d, points.conics, moments, points.opacities, points.depths, points.radii, *size
    )
    variance = sums[..., 1] - sums[..., 0].square() / alpha.clamp_min(CLEAR)
    return variance.clamp_min(0).mean()
