"""The photometric loss, and the drawing that it compares with a training image."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from splatreel.kernels import photometric, rasterize
from splatreel.kernels.binning import TILE, Bins, tiles_of
from splatreel.method.train.terms.term import Due, Iteration, Term, sum_of_weights

LAMBDA_DSSIM = 0.2
"""Weight of structural similarity in the photometric loss, as in 3DGS and the paper (lambda)."""


@dataclass(frozen=True)
class Photometric(Term[Iteration]):
    """Photometric loss of 3DGS: absolute differences and structural similarity, mean over pixels and colors.

        (1 - lambda_dssim) |image - target|  +  lambda_dssim (1 - SSIM)

    Programs compute it while they draw (`compare`). `kernels/photometric.py` has the formula.

    Source:
        3DGS, equation 7.
    """

    wgsl: ClassVar[tuple[str, ...]] = ("windows", "similarity", "photometric")

    def value(self, seen: Iteration) -> float:
        """See `Term`."""
        return seen.photometric or 0.0


class ImageSplats(NamedTuple):
    """Splats of one view that are drawn and compared.

    Attributes:
        bins: The splats, sorted into tiles.
        colors: [N, 3], relative to the background.
        frozen: Static splats of the view to draw among; None if there are none, or if `bins` has them too.
        background: [3]; None is black.
        gain: [3] factor on the drawing; None is 1.
        where: [N] bool, splats whose tiles are compared; None compares those of all splats of `bins`.
        unknown: [H, W] bool, pixels without a target; None if all have one.
        fill: Function from a drawing before the gain to the target whose unknown pixels repeat the drawing.
    """

    bins: Bins
    colors: np.ndarray
    frozen: rasterize.Frozen | None
    background: np.ndarray | None
    gain: np.ndarray | None
    where: np.ndarray | None
    whole: bool
    learns_gain: bool
    unknown: np.ndarray | None
    fill: Callable[[np.ndarray], np.ndarray]


class Compared(NamedTuple):
    """Gradients of a comparison.

    Attributes:
        splats: Gradients to means2d [N, 2], conics [N, 3], colors [N, 3] and opacities [N].
        gain: [3] gradient to the gain; zeros if it was not wanted.
        absolute: [N, 2] see `rasterize.Gradients`.
    """

    splats: list[np.ndarray]
    gain: np.ndarray
    absolute: np.ndarray


def compare(
    given: ImageSplats, static: rasterize.Frozen | None, lambda_dssim: float, seen: Iteration, due: Due
) -> Compared:
    """Draw splats, compare the image with `seen.target`, and set `seen.photometric`.

    `static` are those of the view, also if `given.bins` has them.
    """
    weight = sum_of_weights(Photometric, due)
    others = [(term, factor) for term, factor in due if term.reads_image]
    if not weight and not others:
        return _nothing(given)
    if static is not None and not others and not given.learns_gain:
        return _compare_tiles(given, static, lambda_dssim, seen, weight)
    return _compare_image(given, lambda_dssim, seen, weight, others)


def _compare_tiles(
    given: ImageSplats, static: rasterize.Frozen, lambda_dssim: float, seen: Iteration, weight: float
) -> Compared:
    """Draw and compare only tiles that splats touch, in the image of the static splats."""
    options = lambda_dssim, given.gain, given.background, given.where, given.whole, given.unknown
    seen.photometric, found = photometric.loss_and_gradient_among(
        given.bins, given.colors, static, seen.target, *options
    )
    return _scaled(found, np.zeros(3, np.float32), weight)


def _compare_image(given: ImageSplats, lambda_dssim: float, seen: Iteration, weight: float, others: Due) -> Compared:
    """Draw the whole image. The photometric loss compares the tiles that it would compare without other terms of the image."""
    bins, background, gain = given.bins, given.background, given.gain
    image, alpha = rasterize.forward(bins, given.colors, given.frozen)
    if given.unknown is not None:
        seen.target = given.fill(image if background is None else image + background)
    d_image, d_gain = np.zeros_like(image), np.zeros(3, np.float32)
    if weight:
        tiles = bins.counts > 0 if given.where is None else tiles_of(bins, given.where)
        compared = None if given.whole else tiles.reshape(-(-bins.height // TILE), -1)
        found = photometric.loss_and_gradient(image, seen.target, lambda_dssim, gain, compared, background)
        seen.photometric, d_image, d_gain = found.loss, found.d_image, found.d_gain
        if weight != 1:
            d_image, d_gain = np.float32(weight) * d_image, np.float32(weight) * d_gain
    if others:
        drawn = image if background is None else image + background
        seen.image = drawn.copy() if gain is None else drawn * gain
        seen.d_image = np.zeros_like(image)
        for term, factor in others:
            term.add_to_drawing(seen, factor)
        d_gain = d_gain + (seen.d_image * drawn).sum((0, 1))
        d_image = d_image + (seen.d_image if gain is None else seen.d_image * gain)
    none = rasterize.no_gradient(alpha.shape)
    return _scaled(rasterize.backward(bins, given.colors, image, d_image, alpha, none, given.frozen), d_gain)


def _scaled(found: rasterize.Gradients, d_gain: np.ndarray, weight: float = 1.0) -> Compared:
    splats = [found.means2d, found.conics, found.colors, found.opacities]
    if weight == 1:
        return Compared(splats, d_gain, found.absolute)
    factor = np.float32(weight)
    return Compared([factor * part for part in splats], factor * d_gain, factor * found.absolute)


def _nothing(given: ImageSplats) -> Compared:
    sizes = (2,), (3,), (3,), ()
    zeros = [np.zeros((len(given.colors), *size), np.float32) for size in sizes]
    return Compared(zeros, np.zeros(3, np.float32), np.zeros((len(given.colors), 2), np.float32))
