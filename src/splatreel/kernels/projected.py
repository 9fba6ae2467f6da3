"""Gaussians projected to the image of one view: their shapes, and splats that are ready to be drawn."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor


class Projection(NamedTuple):
    """Gaussians projected to an image. Rows of culled Gaussians are zero.

    Attributes:
        means2d: [N, 2] pixels.
        conics: [N, 3], xx, xy, yy of the inverse 2D covariance.
        depths: [N] along the camera's z, world units.
        radii: [N] int32, the longer half side of the box where alpha may reach 1/255, pixels; 0 for culled Gaussians.
    """

    means2d: Tensor
    conics: Tensor
    depths: Tensor
    radii: Tensor

    def colored(self, colors: Tensor, opacities: Tensor) -> Splats:
        """Return the splats with colors [N, C] and opacities [N]."""
        return Splats(self.means2d, self.conics, colors, opacities, self.depths, self.radii)


class Splats(NamedTuple):
    """Projected Gaussians of one view with their colors. Drawing gives gradients to the first four fields.

    Attributes:
        means2d: [N, 2], see `Projection`.
        conics: [N, 3], see `Projection`.
        colors: [N, C] with any number of channels, or three where a function says so.
        opacities: [N], 0..1.
        depths: [N], see `Projection`.
        radii: [N] int32, see `Projection`.
    """

    means2d: Tensor
    conics: Tensor
    colors: Tensor
    opacities: Tensor
    depths: Tensor
    radii: Tensor

    def rows(self, index: Tensor) -> Splats:
        """Return the rows of an index [M] int64."""
        return Splats(*[tensor.index_select(0, index) for tensor in self])

    def relative_to(self, background: Tensor | None) -> Splats:
        """Return the splats with colors relative to a background color [3]; None is black.

        The background is to be added to the blended image. This blends it behind everything without using alpha:
        sum w c + (1 - sum w) b = sum w (c - b) + b.
        """
        return self if background is None else self._replace(colors=self.colors - background)

    def with_gain(self, factor: Tensor, background: Tensor | None) -> Splats:
        """Return the splats with colors multiplied by a factor [3]. They stay relative to the background [3], which keeps its color."""
        if background is None:
            return self._replace(colors=self.colors * factor)
        return self._replace(colors=(self.colors + background) * factor - background)

    @staticmethod
    def join(a: Splats, b: Splats) -> Splats:
        """Concatenate two sets of splats."""
        return Splats(*[torch.cat(pair) for pair in zip(a, b, strict=True)])


class FrozenSplats(NamedTuple):
    """Splats that do not change, drawn once for one view. `freeze` makes them; `rasterize_among` draws other splats among them.

    Attributes:
        image: [H, W, 3].
        alpha: [H, W].
        held: Whatever the backend needs to draw other splats among them.
    """

    image: Tensor
    alpha: Tensor
    held: Any
