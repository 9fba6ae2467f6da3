"""Terms of surfaces, for scenes with few cameras: nothing in front of surfaces, and planes where images are plain.

Both look at an image of log depths (`Depths`). It shows the trained points alone, also where static points are behind them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from splatreel.method.train.terms.term import Depths, Iteration, Term

MIN_VARIANCE = 1e-5
"""Variance of log depths below which a pixel shows one surface."""
MAX_SEPARATION = 0.45
"""Difference of log depths beyond which the cost stops growing: content behind a window is correct."""
EDGE_CONTRAST = 0.05
"""Contrast, 0..1, at which a bend in depth costs a third of its cost in a plain area."""


@dataclass(frozen=True)
class Spread(Term[Iteration]):
    """Points in front of the surface that a pixel shows, mean over pixels.

    It is the distortion loss of Mip-NeRF 360 made one-sided. The original pulls the points of a pixel together wherever most of
    them are. Mist that fills more than half of a pixel then grows, and captures of plain walls end in it. Here mist only fades.

    The first three moments m1, m2, m3 of log depth split a pixel's points into a front layer, and a far layer at depth z with a share
    f of the points. Each layer costs f^2 times its squared distance to the far layer. The cost stops growing at `MAX_SEPARATION`. It
    is a mean over what the pixel shows, so that opacity itself costs nothing. Log depths do not depend on world units.

        mean over pixels of  alpha f^2 min(1, MAX_SEPARATION^2 / separation^2) (m2 - 2 z m1 + z^2)

    The layers, alpha and the limit are held constant in the gradient.

    Source:
        Barron et al. 2022, equation 15.
    """

    wgsl: ClassVar[tuple[str, ...]] = ("surfaces",)
    exact: ClassVar[bool] = False

    def value(self, seen: Iteration) -> float:
        """See `Term`."""
        return spread(seen.depths)

    def add_to_drawing(self, seen: Iteration, weight: float) -> None:
        """See `Term`."""
        depths = seen.depths
        far, factor = _layers(depths)
        d_second = factor * np.float32(weight / depths.alpha.size)
        depths.d_first += -2 * far * d_second
        depths.d_second += d_second


@dataclass(frozen=True)
class Roughness(Term[Iteration]):
    """Bends in depth where the image has no edges, mean over pixels.

    The inverse depth of a plane is an affine function of the pixel, so its second differences d along rows and columns vanish.

        mean over rows of  exp(-contrast / EDGE_CONTRAST) |d|  +  the same over columns

    Inverse depth is in units of the typical viewing distance. The contrast over two pixels makes a bend cheaper. The depths of points
    are held constant in the gradient: points fade or grow instead of moving.

    Source:
        Woodford et al. 2009, "Global stereo reconstruction under second-order smoothness priors".
    """

    wgsl: ClassVar[tuple[str, ...]] = ("surfaces",)
    exact: ClassVar[bool] = False

    def value(self, seen: Iteration) -> float:
        """See `Term`."""
        return roughness(seen.depths, seen.target, seen.unit / seen.near)

    def add_to_drawing(self, seen: Iteration, weight: float) -> None:
        """See `Term`."""
        depths = seen.depths
        inverse = _inverse_depth(depths, seen.unit / seen.near)
        d_inverse = np.zeros_like(inverse)
        for bend, plain, slopes in _bends(inverse, seen.target, d_inverse):
            slope = np.sign(bend) * plain
            slope *= np.float32(weight / bend.size)
            slopes[:-2] += slope
            slopes[1:-1] -= 2 * slope
            slopes[2:] += slope
        depths.d_first += -inverse * d_inverse


def spread(depths: Depths) -> float:
    """Return the value of `Spread`."""
    first, second, _ = np.moveaxis(depths.moments, -1, 0)
    far, factor = _layers(depths)
    return float((factor * (second - 2 * far * first + far * far)).mean())


def roughness(depths: Depths, image: np.ndarray, span: float) -> float:
    """Return the value of `Roughness`.

    `span` is the typical viewing distance in multiples of the near plane, the unit of inverse depth.
    """
    inverse = _inverse_depth(depths, span)
    return float(sum((plain * np.abs(bend)).mean() for bend, plain, _ in _bends(inverse, image, inverse)))


def _layers(depths: Depths) -> tuple[np.ndarray, np.ndarray]:
    """Return the log depth [H, W] of the far layer, and the factor [H, W] of the squared distances to it."""
    first, second, third = np.moveaxis(depths.moments, -1, 0)
    variance = np.maximum(second - first * first, np.float32(MIN_VARIANCE))
    deviation = np.sqrt(variance)
    skewness = (third - 3 * first * variance - first * first * first) / (variance * deviation)
    root = np.sqrt(skewness * skewness + 4)
    far = first + deviation * (skewness + root) / 2
    share = (root - skewness) / (2 * root)
    limit = np.minimum(np.float32(MAX_SEPARATION**2) / (variance * root * root), 1)
    return far, depths.alpha * share * share * limit


def _inverse_depth(depths: Depths, span: float) -> np.ndarray:
    return np.float32(span) * np.exp(-depths.moments[..., 0])


def _bends(
    inverse: np.ndarray, image: np.ndarray, along: np.ndarray
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return the second differences of inverse depth along columns and rows, their factors, and a view of `along` in that order."""
    colors = image.astype(np.int16)
    for swap in (False, True):
        depth, other, pixels = (each.swapaxes(0, 1) if swap else each for each in (inverse, along, colors))
        contrast = np.abs(pixels[2:] - pixels[:-2]).max(-1).astype(np.float32)
        plain = np.exp(contrast * np.float32(-1 / (255 * EDGE_CONTRAST)))
        yield depth[:-2] - 2 * depth[1:-1] + depth[2:], plain, other
