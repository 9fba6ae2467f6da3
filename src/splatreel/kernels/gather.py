"""Sums of images over the pixels of splats, such as the share of each splat that lies in a mask."""

from __future__ import annotations

from torch import Tensor

from splatreel.kernels import splat
from splatreel.kernels.backends import backend_of
from splatreel.kernels.projected import Projection


def gather(projection: Projection, opacities: Tensor, images: Tensor) -> Tensor:
    """Return the sum of images over the pixels of each splat, [N, K], weighted by the splat's share of each pixel.

    The sum is the gradient of a drawn image with respect to the colors of the splats. It takes less time than this gradient, because
    the gradients with respect to all other properties are left out. The result has no gradient.

    Args:
        projection: N projected points.
        opacities: [N], 0..1.
        images: [H, W, K].

    Raises:
        GaussiansError: A value is NaN or infinite.
    """
    splat.check_finite(means2d=projection.means2d, conics=projection.conics, opacities=opacities)
    return backend_of(projection.means2d).gather(projection, opacities, images)
