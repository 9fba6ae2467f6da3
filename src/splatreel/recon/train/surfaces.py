"""What keeps a keyframe's surfaces plausible where few cameras look: nothing before them, and planes where pictures are plain."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from splatreel.kernels import splat
from splatreel.recon.train.render import Splats, View

CLEAR = 1e-3
"""Alpha below which a pixel shows nothing that could be apart."""
VAGUE = 1e-5
"""Variance of log depths below which a pixel shows one surface."""
APART = 0.45
"""Difference of log depths beyond which layers pay no more for being apart: what is seen through a window is no mistake."""
EDGE = 0.05
"""Contrast (0..1) at which a bend in depth costs a third of what it does where a picture is plain."""


@dataclass(frozen=True)
class Depths:
    """What depth a view shows. moments: [H, W, 3] mean log depth over the near plane, its square and its cube; alpha: [H, W]."""

    moments: Tensor
    alpha: Tensor

    @staticmethod
    def of(points: Splats, view: View, near: float) -> Depths:
        """Depths themselves get no gradient, opacities do: what is where it should not be shall fade and not move."""
        depth = (points.depths.detach().clamp_min(near) / near).log()
        powers = torch.stack([depth, depth.square(), depth**3], 1)
        size = view.width, view.height
        sums, alpha = splat.rasterize(
            points.means2d, points.conics, powers, points.opacities, points.depths, points.radii, *size
        )
        return Depths(sums / alpha.clamp_min(CLEAR)[..., None], alpha)


def spread(depths: Depths) -> Tensor:
    """What lies before the surface that a pixel shows, by the square of its distance to it in log depth; mean over pixels.

    It is the distortion loss of Mip-NeRF 360 (Barron et al. 2022, equation 15) made one-sided. That pulls a pixel's points together
    wherever most of them are: mist that fills more than half of a pixel is made to fill all of it, and captures before plain walls end
    in it. Here mist only ever fades. A pixel's points are taken for two layers, which the first three moments of their log depths
    tell: a front one, and a far one that makes up a share f of them. Each pays f^2 times its squared distance to the far one, less
    where the layers are farther apart than `APART`, as a mean over what the pixel shows: how much it shows costs nothing. Log
    depths mean the same in millimeters and in meters.
    """
    first, second, third = depths.moments.unbind(-1)
    with torch.no_grad():
        variance = (second - first.square()).clamp_min(VAGUE)
        skewness = (third - 3 * first * variance - first**3) / variance**1.5
        root = (skewness.square() + 4).sqrt()
        far = first + variance.sqrt() * (skewness + root) / 2
        share = (root - skewness) / (2 * root)
        weight = depths.alpha * share.square() * (APART**2 / (variance * root.square())).clamp_max(1)
    return (weight * (second - 2 * far * first + far.square())).mean()


def roughness(depths: Depths, picture: Tensor, span: float) -> Tensor:
    """How little what a view shows is made of planes where its picture has no edges; mean over pixels.

    The inverse depth of a plane is an affine function of the pixel, so its second differences along rows and columns vanish (as
    in smoothness terms of stereo and monocular depth: Woodford et al. 2009, "Global stereo reconstruction under second-order smoothness
    priors"). picture: [H, W, 3] uint8, whose contrast over two pixels makes a bend cheaper. span: what one is in inverse depth, in
    multiples of the near plane: the typical viewing distance.
    """
    inverse = span * (-depths.moments[..., 0]).exp()
    colors = picture.float() / 255
    cost = inverse.new_zeros(())
    for along in (0, 1):
        before, here, after = (inverse.narrow(along, k, inverse.shape[along] - 2) for k in range(3))
        first, last = (colors.narrow(along, k, inverse.shape[along] - 2) for k in (0, 2))
        plain = torch.exp((last - first).abs().amax(-1) / -EDGE)
        cost = cost + (plain * (before - 2 * here + after).abs()).mean()
    return cost
