"""Image of the depths of splats, and the gradient to the splats."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from splatreel.kernels import rasterize, splat
from splatreel.kernels.binning import Bins
from splatreel.kernels.splat import Splats
from splatreel.method.train.render import View

MIN_ALPHA = 1e-3
"""Alpha below which a pixel shows nothing."""


@dataclass
class Depths:
    """Depths of a view. Only opacities and shapes of splats get gradients, so that misplaced points fade instead of moving.

    Attributes:
        moments: [H, W, 3] mean log depth over the near plane, its square and its cube.
        alpha: [H, W] opacity.
        d_first: [H, W] gradient to the mean, to which terms add.
        d_second: [H, W] gradient to the mean square, likewise.
    """

    moments: np.ndarray
    alpha: np.ndarray
    _bins: Bins
    _powers: np.ndarray
    _sums: np.ndarray
    d_first: np.ndarray = field(init=False)
    d_second: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        """Start with gradients of zero."""
        self.d_first, self.d_second = np.zeros_like(self.alpha), np.zeros_like(self.alpha)

    @staticmethod
    def of(splats: Splats, view: View, near: float, bins: Bins | None = None) -> Depths:
        """Draw the depths of splats. bins: the splats, sorted into tiles; None sorts them."""
        bins, powers = bins or splat.bin(splats, view.width, view.height), depth_powers(splats.depths, near)
        sums, alpha = rasterize.forward(bins, powers)
        shown = np.maximum(alpha, np.float32(MIN_ALPHA))
        return Depths(sums / shown[..., None], alpha, bins, powers, sums)

    def to_splats(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the gradients to the means2d [N, 2], conics [N, 3] and opacities [N] of the splats."""
        d_sums, d_alpha = self.to_drawing()
        found = rasterize.backward(self._bins, self._powers, self._sums, d_sums, self.alpha, d_alpha)
        return found.means2d, found.conics, found.opacities

    def to_drawing(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the gradients to the blended powers of depths [H, W, 3] and to alpha [H, W]."""
        shown = np.maximum(self.alpha, np.float32(MIN_ALPHA))
        first, second, _ = (self.moments[..., k] for k in range(3))
        d_sums = np.stack([self.d_first / shown, self.d_second / shown, np.zeros_like(first)], -1)
        d_alpha = -(d_sums[..., 0] * first + d_sums[..., 1] * second) * (self.alpha >= np.float32(MIN_ALPHA))
        return d_sums, d_alpha


def depth_powers(depths: np.ndarray, near: float) -> np.ndarray:
    """Return the log depths over the near plane, their squares and their cubes, [N, 3], of depths [N]."""
    depth = np.log(np.maximum(depths, np.float32(near)) / np.float32(near))
    square = depth * depth
    return np.stack([depth, square, square * depth], 1)
