"""Sums of images over the pixels of splats, such as the share of each splat that lies in a mask."""

from __future__ import annotations

from torch import Tensor

from splatreel.kernels import splat
from splatreel.kernels.backends import backend_of


def gather(means2d: Tensor, conics: Tensor, opacities: Tensor, depths: Tensor, radii: Tensor, images: Tensor) -> Tensor:
    """Return the sum of images over the pixels of each splat, [N, K], weighted by the splat's share of each pixel.

    The sum is the gradient of a drawn image with respect to the colors of the splats. It takes less time than this gradient, because
    the gradients with respect to all other properties are left out. The result has no gradient.

    Args:
        means2d: [N, 2], as `splat.project` returns it.
        conics: [N, 3], as `splat.project` returns it.
        opacities: [N], 0..1.
        depths: [N], as `splat.project` returns it.
        radii: [N], as `splat.project` returns it.
        images: [H, W, K].

    Raises:
        GaussiansError: A value is NaN or infinite.
    """
    splat.check_finite(means2d=means2d, conics=conics, opacities=opacities)
    return backend_of(means2d).gather(means2d, conics, opacities, depths, radii, images)
