"""Regularizers: rigidity of motion and its smoothness in time (paper section 4.2), and surfaces of keyframes.

The losses of surfaces are for scenes with few cameras: nothing in front of surfaces, and planes where images are plain.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from splatreel.kernels import motion, splat
from splatreel.kernels.projected import Splats
from splatreel.method.deform.protocol import Deformation
from splatreel.method.train.render import View

MIN_ALPHA = 1e-3
"""Alpha below which a pixel shows nothing."""
MIN_VARIANCE = 1e-5
"""Variance of log depths below which a pixel shows one surface."""
MAX_SEPARATION = 0.45
"""Difference of log depths beyond which the cost stops growing: content behind a window is correct."""
EDGE_CONTRAST = 0.05
"""Contrast, 0..1, at which a bend in depth costs a third of its cost in a plain area."""


@dataclass(frozen=True)
class Neighbors:
    """The K nearest neighbors of N points, by rank.

    Attributes:
        index: [K, N] int64.
        closeness: [K, N], 1 where two points coincide.
    """

    index: Tensor
    closeness: Tensor

    @staticmethod
    def of(means: Tensor, count: int) -> Neighbors | None:
        """Find up to `count` neighbors for each of the means [N, 3]; return None for fewer than two points."""
        if len(means) < 2:
            return None
        index, distance = splat.nearest_neighbors(means.detach(), min(count, len(means) - 1))
        width = 2 * distance[:, -1:].median().clamp_min(1e-9)
        closeness = torch.exp(-((distance / width) ** 2))
        return Neighbors(index.T.contiguous(), closeness.T.contiguous())  # an iteration uses one rank of all points


def arap(means: Tensor, dx: Tensor, dq: Tensor, neighbor: Tensor, weights: Tensor, unit: float) -> Tensor:
    """Return L_arap, mean over points: neighbors share rotation and translation, and keep their distance.

    Only the offsets get gradients.

    Args:
        means: [N, 3] positions.
        dx: [N, 3] position offsets.
        dq: [N, 4] rotation offsets.
        neighbor: [N] one neighbor of every point.
        weights: [N] weight of each pair.
        unit: Length that distances are divided by, so that the loss does not depend on world units.
    """
    return motion.arap(means.detach(), dx, dq, neighbor, weights, unit)


def temporal(model: Deformation, means: Tensor, frame: float, other: float, delta: float, unit: float) -> Tensor:
    """Return L_temp, mean over points: between two close frames, offsets are linear in time.

    The last term of the printed formula mixes an offset with a position. It is read as the offset at frame + delta (other -
    frame).

    Args:
        model: Deformation model.
        means: [N, 3] positions.
        frame: First frame.
        other: Second frame.
        delta: Position of the sample between the two frames, 0..1.
        unit: Typical viewing distance, world units.
    """
    dx0, dq0 = model.offsets(means, frame)
    dx1, dq1 = model.offsets(means, other)
    dx, dq = model.offsets(means, frame + delta * (other - frame))
    position = ((1 - delta) * dx0 + delta * dx1 - dx).abs().sum(1) / unit
    rotation = ((1 - delta) * dq0 + delta * dq1 - dq).abs().sum(1)
    return (position + rotation).mean()


@dataclass(frozen=True)
class Depths:
    """Depths of a view.

    Attributes:
        moments: [H, W, 3] mean log depth over the near plane, its square and its cube.
        alpha: [H, W] opacity.
    """

    moments: Tensor
    alpha: Tensor

    @staticmethod
    def of(points: Splats, view: View, near: float) -> Depths:
        """Draw the depths of points. Only opacities get gradients, so that misplaced points fade instead of moving."""
        depth = (points.depths.detach().clamp_min(near) / near).log()
        powers = torch.stack([depth, depth.square(), depth**3], 1)
        size = view.width, view.height
        sums, alpha = splat.rasterize(points._replace(colors=powers), *size)
        return Depths(sums / alpha.clamp_min(MIN_ALPHA)[..., None], alpha)


def spread(depths: Depths) -> Tensor:
    """Return the loss of points in front of the surface that a pixel shows, mean over pixels.

    It is the distortion loss of Mip-NeRF 360 made one-sided. The original pulls the points of a pixel together wherever most of
    them are. Mist that fills more than half of a pixel then grows, and captures of plain walls end in it. Here mist only fades.

    The first three moments of log depth split a pixel's points into a front layer, and a far layer with a share f of the
    points. Each layer costs f^2 times its squared distance to the far layer. The cost stops growing at `MAX_SEPARATION`. It is
    a mean over what the pixel shows, so that opacity itself costs nothing. Log depths do not depend on world units.

    Source:
        Barron et al. 2022, equation 15.
    """
    first, second, third = depths.moments.unbind(-1)
    with torch.no_grad():
        variance = (second - first.square()).clamp_min(MIN_VARIANCE)
        skewness = (third - 3 * first * variance - first**3) / variance**1.5
        root = (skewness.square() + 4).sqrt()
        far = first + variance.sqrt() * (skewness + root) / 2
        share = (root - skewness) / (2 * root)
        weight = depths.alpha * share.square() * (MAX_SEPARATION**2 / (variance * root.square())).clamp_max(1)
    return (weight * (second - 2 * far * first + far.square())).mean()


def roughness(depths: Depths, image: Tensor, span: float) -> Tensor:
    """Return the loss of bends in depth where the image has no edges, mean over pixels.

    The inverse depth of a plane is an affine function of the pixel, so its second differences along rows and columns vanish.

    Args:
        depths: Depths of the view.
        image: [H, W, 3] uint8. Contrast over two pixels makes a bend cheaper.
        span: Typical viewing distance in multiples of the near plane, the unit of inverse depth.

    Source:
        Woodford et al. 2009, "Global stereo reconstruction under second-order smoothness priors".
    """
    inverse = span * (-depths.moments[..., 0]).exp()
    colors = image.float() / 255
    cost = inverse.new_zeros(())
    for along in (0, 1):
        before, here, after = (inverse.narrow(along, k, inverse.shape[along] - 2) for k in range(3))
        first, last = (colors.narrow(along, k, inverse.shape[along] - 2) for k in (0, 2))
        plain = torch.exp((last - first).abs().amax(-1) / -EDGE_CONTRAST)
        cost = cost + (plain * (before - 2 * here + after).abs()).mean()
    return cost
