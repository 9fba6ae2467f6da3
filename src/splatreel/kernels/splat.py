"""Gaussian splatting on arrays: projection, drawing, and the gradient of a drawing to its splats.

The kernels follow gsplat's rules. 0.3 px^2 is added to the diagonal of the 2D covariance. Alpha is min(0.999, opacity exp(-sigma)), and
alphas below 1/255 are skipped. A pixel is full once its transmittance would fall to 1e-4. Pixel centers are at +0.5. Training calls
`deform`, `binning`, `rasterize` and `photometric` directly, which check nothing.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import KDTree

from splatreel.base import threads
from splatreel.base.errors import GaussiansError
from splatreel.kernels import binning
from splatreel.kernels import project as projection
from splatreel.kernels import rasterize as drawing
from splatreel.kernels.blending import CHANNELS

__all__ = ["nearest_neighbors"]

QUERIES = 512
"""Smallest number of queries for neighbors that is worth a thread."""


class Projection(NamedTuple):
    """Gaussians projected to an image. Rows of culled Gaussians are zero.

    Attributes:
        means2d: [N, 2] pixels.
        conics: [N, 3], xx, xy, yy of the inverse 2D covariance.
        depths: [N] along the camera's z, world units.
        radii: [N] int32, the longer half side of the box where alpha may reach 1/255, pixels; 0 for culled Gaussians.
    """

    means2d: np.ndarray
    conics: np.ndarray
    depths: np.ndarray
    radii: np.ndarray

    def colored(self, colors: np.ndarray, opacities: np.ndarray) -> Splats:
        """Return the splats with colors [N, C] and opacities [N]."""
        return Splats(self.means2d, self.conics, colors, opacities, self.depths, self.radii)


class Splats(NamedTuple):
    """Projected Gaussians of one view, see `Projection`, with colors [N, C] of any number of channels and opacities [N], 0..1."""

    means2d: np.ndarray
    conics: np.ndarray
    colors: np.ndarray
    opacities: np.ndarray
    depths: np.ndarray
    radii: np.ndarray

    def rows(self, index: np.ndarray) -> Splats:
        """Return the rows of an index [M] int64."""
        return Splats(*[array[index] for array in self])

    def relative_to(self, background: np.ndarray | None) -> Splats:
        """Return the splats with colors relative to a background color [3]; None is black.

        The background is to be added to the blended image. This blends it behind everything without using alpha:
        sum w c + (1 - sum w) b = sum w (c - b) + b.
        """
        return self if background is None else self._replace(colors=self.colors - background)

    @staticmethod
    def join(a: Splats, b: Splats) -> Splats:
        """Concatenate two sets of splats."""
        return Splats(*[np.concatenate(pair) for pair in zip(a, b, strict=True)])


def project(
    means: np.ndarray,
    quats: np.ndarray,
    scales: np.ndarray,
    viewmat: np.ndarray,
    K: np.ndarray,
    width: int,
    height: int,
    near: float = 0.01,
    antialias: bool = False,
) -> Projection:
    """Project Gaussians to an image. `antialias` adds 0.1 px^2 to the covariance instead of 0.3, for `antialiased` opacities.

    NaN and infinity raise a `GaussiansError`.
    """
    check_finite(means=means, quats=quats, scales=scales)
    blur = projection.FINE_BLUR if antialias else projection.BLUR
    view = projection.Pinhole(_floats(viewmat), _floats(K), width, height, near, blur)
    return Projection(*projection.forward(_floats(means), _floats(quats), _floats(scales), view))


def antialiased(opacities: np.ndarray, conics: np.ndarray) -> np.ndarray:
    """Return opacities [N] reduced by the area that antialiasing adds to splats with conics [N, 3].

    Without this factor a splat thinner than a pixel covers as much as one of a pixel, and images of other sizes than the training
    images look too thick or too thin. The factor is sqrt(det C / det(C + 0.1)).

    Source: Mip-Splatting, section 4.2 (gsplat's `antialiased` uses 0.3).
    """
    return opacities * np.sqrt(np.maximum(projection.kept_area(*conics.T), 1e-6))


def bin(splats: Splats, width: int, height: int) -> binning.Bins:
    """Sort splats into the tiles of an image. NaN and infinity raise a `GaussiansError`."""
    _check_splats(splats)
    means2d, conics, _, opacities, depths, radii = splats
    shapes = _floats(means2d), _floats(conics), _floats(opacities), _floats(depths)
    return binning.bin_splats(*shapes, np.ascontiguousarray(radii, np.int32), width, height)


def rasterize(
    splats: Splats, width: int, height: int, frozen: drawing.Frozen | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Blend projected Gaussians front to back over black. Return the image [H, W, C] and alpha [H, W].

    With `frozen` splats they are blended in the order of all depths, and C must be 3. Tiles that no other splat touches
    keep their image. NaN and infinity raise a `GaussiansError`.
    """
    bins = bin(splats, width, height)
    parts = [drawing.forward(bins, part, frozen) for part in _split(splats.colors)]
    return _join([image for image, _ in parts], splats.colors.shape[1]), parts[0][1]


def rasterize_gradient(
    splats: Splats,
    width: int,
    height: int,
    image: np.ndarray,
    alpha: np.ndarray,
    d_image: np.ndarray,
    d_alpha: np.ndarray | None = None,
    frozen: drawing.Frozen | None = None,
) -> drawing.Gradients:
    """Return the gradient to N splats of a value whose gradient to the drawing is known. `image` and `alpha` are from `rasterize`.

    `Gradients.absolute` sums the absolute gradients of `means2d` over tiles of 16 x 16 pixels and every three channels.
    There, gradients that cancel each other count, as missing detail does (Ye et al. 2024, "AbsGS: Recovering fine
    details for 3D Gaussian Splatting"). Frozen splats get no gradient. NaN and infinity raise a `GaussiansError`.
    """
    bins, nothing = bin(splats, width, height), drawing.no_gradient((height, width))
    to_alpha = nothing if d_alpha is None else _floats(d_alpha)
    parts = []
    for colors, drawn, d_drawn in zip(_split(splats.colors), _split(image), _split(d_image), strict=True):
        parts.append(drawing.backward(bins, colors, drawn, d_drawn, alpha, to_alpha, frozen))
        to_alpha = nothing  # all parts share one alpha: count its gradient once
    if len(parts) == 1 and splats.colors.shape[1] == CHANNELS:
        return parts[0]
    total = drawing.Gradients(*(np.sum(some, 0) for some in zip(*parts, strict=True)))
    return total._replace(colors=_join([part.colors for part in parts], splats.colors.shape[1]))


def freeze(splats: Splats, width: int, height: int) -> drawing.Frozen:
    """Draw splats that will not change, with colors [M, 3], to draw others among them. NaN and infinity raise a `GaussiansError`."""
    bins, colors = bin(splats, width, height), _floats(splats.colors)
    return drawing.Frozen(bins, colors, *drawing.forward(bins, colors))


def gather(projected: Projection, opacities: np.ndarray, images: np.ndarray) -> np.ndarray:
    """Return the sum of images [H, W, K] over the pixels of each splat, [N, K], weighted by the splat's share of each pixel.

    The sum is the gradient of a drawn image to the colors of the splats. It takes less time than `rasterize_gradient`,
    because the gradients to all other properties are left out. NaN and infinity raise a `GaussiansError`.
    """
    height, width = images.shape[:2]
    bins = bin(projected.colored(np.zeros((len(opacities), 0), np.float32), opacities), width, height)
    return drawing.gather(bins, _floats(images))


def _check_splats(splats: Splats) -> None:
    check_finite(means2d=splats.means2d, conics=splats.conics, colors=splats.colors, opacities=splats.opacities)


def check_finite(**arrays: np.ndarray) -> None:
    """Raise a `GaussiansError` that names the array if one holds NaN or infinity."""
    for name, array in arrays.items():
        with np.errstate(over="ignore", invalid="ignore"):
            total = float(np.sum(array))
        # The sum is quick, but may overflow.
        if not math.isfinite(total) and not np.isfinite(array).all():
            bad = np.count_nonzero(~np.isfinite(array))
            raise GaussiansError(
                f"Gaussians: {name} holds {bad} values that are NaN or infinite; lower the learning rate."
            )


def _floats(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, np.float32)


def _split(values: np.ndarray) -> list[np.ndarray]:
    """Divide values [..., C] into parts of three channels, the last one padded with zeros."""
    channels = values.shape[-1]
    if channels == CHANNELS:
        return [_floats(values)]
    padded = np.pad(values, [(0, 0)] * (values.ndim - 1) + [(0, -channels % CHANNELS)])
    return [_floats(padded[..., k : k + CHANNELS]) for k in range(0, channels, CHANNELS)]


def _join(parts: list[np.ndarray], channels: int) -> np.ndarray:
    """Undo `_split`."""
    return parts[0] if channels == CHANNELS else np.ascontiguousarray(np.concatenate(parts, -1)[..., :channels])


def nearest_neighbors(points: np.ndarray, k: int, queries: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return the k nearest points of each query: indices [Q, k] int64 and distances [Q, k] float32, nearest first.

    `queries` [Q, 3] are by default the points themselves, without each point's match with itself.

    Raises:
        GaussiansError: There are fewer than k points.
    """
    available = len(points) - (queries is None)
    if not 1 <= k <= available:
        raise GaussiansError(f"nearest_neighbors: asked for {k} neighbors where there are {available}.")
    ranks: Any = np.arange(1, k + 1 + (queries is None))  # a list, so that one neighbor still gives a column
    tree, wanted = KDTree(points), points if queries is None else queries
    distances, indices = np.empty((len(wanted), len(ranks)), np.float32), np.empty((len(wanted), len(ranks)), np.int64)

    def find(first: int, last: int) -> None:
        distances[first:last], indices[first:last] = tree.query(wanted[first:last], k=ranks)

    threads.run_ranges(find, len(wanted), (), grain=QUERIES)
    return (indices, distances) if queries is not None else _without_self(indices, distances)


def _without_self(indices: np.ndarray, distances: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Remove each point from its own neighbors. Among coinciding points it is not always the first."""
    own = indices == np.arange(len(indices))[:, None]
    own[~own.any(1), -1] = True  # coinciding points took its place: drop the last neighbor instead
    shape = (len(indices), indices.shape[1] - 1)
    return indices[~own].reshape(shape), distances[~own].reshape(shape)
