"""The interface between the public functions of `splat`, `motion` and `adam` and the kernels of one kind of device."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from splatreel.kernels import twin
from splatreel.kernels.cpu.project import kept_area
from splatreel.kernels.projected import FrozenSplats, Projection, Splats
from splatreel.kernels.twin import Missed, Skin, Step

Pinhole = tuple[Tensor, Tensor, int, int]
"""viewmat [4, 4], K [3, 3], width, height."""


class Backend(ABC):
    """Kernels for tensors of one kind of device.

    These modules document the functions and check their arguments. A backend must implement projection, harmonics and
    rasterization. Everything else has a default in plain torch, which a backend overrides where it has something faster.
    """

    @abstractmethod
    def project(
        self,
        means: Tensor,
        quats: Tensor,
        scales: Tensor,
        viewmat: Tensor | np.ndarray,
        K: Tensor | np.ndarray,
        width: int,
        height: int,
        near: float,
        antialias: bool,
    ) -> Projection:
        """Return projected Gaussians."""

    @abstractmethod
    def spherical_harmonics(self, degree: int, directions: Tensor, coefficients: Tensor) -> Tensor:
        """Return the sum of the harmonics [N, 3]."""

    @abstractmethod
    def rasterize(
        self, splats: Splats, width: int, height: int, absolute: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Return image and alpha. absolute: see `splat.rasterize`."""

    def gather(self, projection: Projection, opacities: Tensor, images: Tensor) -> Tensor:
        """Return the sums of images over the pixels of splats."""
        colors = images.new_zeros(len(opacities), images.shape[2], requires_grad=True)
        with torch.enable_grad():
            drawn = self.rasterize(projection.colored(colors, opacities), images.shape[1], images.shape[0])[0]
        return torch.autograd.grad(drawn, colors, images)[0]

    @abstractmethod
    def freeze(self, splats: Splats, width: int, height: int) -> FrozenSplats:
        """Draw splats once."""

    @abstractmethod
    def remove(self, frozen: FrozenSplats, gone: Tensor) -> FrozenSplats:
        """Return frozen splats without the rows `gone` [K]."""

    @abstractmethod
    def rasterize_among(self, splats: Splats, frozen: FrozenSplats) -> tuple[Tensor, Tensor, Tensor]:
        """Return image, alpha and the tiles that were drawn again."""

    def view_colors(self, means: Tensor, center: Tensor, base: Tensor, rest: Tensor) -> Tensor:
        """Return the colors of points for a camera at `center`."""
        return twin.view_colors(means, center, base, rest, self.spherical_harmonics)

    def deform(
        self,
        points: Sequence[Tensor],
        offsets: tuple[Tensor, Tensor] | None,
        shade: Tensor | None,
        pinhole: Pinhole,
        center: Tensor,
        near: float,
        antialias: bool,
    ) -> Splats:
        """Return the splats of deformed points."""
        means, quats, log_scales, logits, base, rest = points
        if shade is not None:
            base, logits = base + shade[:, None, :3], logits + shade[:, 3]
        if offsets is not None:
            means, quats = means + offsets[0], twin.turn(quats, offsets[1])
        opacities = logits.sigmoid()
        projection = self.project(means, quats, log_scales.exp(), *pinhole, near, antialias)
        if antialias:
            opacities = antialiased(opacities, projection.conics)
        return projection.colored(self.view_colors(means, center, base, rest), opacities)

    def photometric_loss(
        self, image: Tensor, target: Tensor, lambda_dssim: float, gain: Tensor | None, tiles: Tensor | None
    ) -> Tensor:
        """Return the loss of an image."""
        return twin.photometric_loss(image, target, lambda_dssim, gain, tiles)

    def layered_loss(
        self,
        splats: Splats,
        frozen: FrozenSplats,
        target: Tensor,
        lambda_dssim: float,
        gain: Tensor | None,
        background: Tensor | None,
        where: Tensor | None,
    ) -> Tensor:
        """Return the loss of splats drawn among frozen splats, or of these splats alone if `where` is given."""
        if where is None:
            image, _, _ = self.rasterize_among(splats, frozen)
        else:
            height, width = frozen.alpha.shape
            image, _ = self.rasterize(splats, width, height)
        return self.photometric_loss(
            image if background is None else image + background, target, lambda_dssim, gain, None
        )

    def hashgrid(self, coords: Tensor, table: Tensor, resolutions: np.ndarray) -> Tensor:
        """Return the features of a hash grid."""
        return twin.hashgrid(coords, table, resolutions)

    def arap(self, means: Tensor, dx: Tensor, dq: Tensor, neighbor: Tensor, weights: Tensor, unit: float) -> Tensor:
        """Return the as-rigid-as-possible loss."""
        return twin.arap(means, dx, dq, neighbor, weights, unit)

    def spline(self, controls: Tensor, knot: int, weights: np.ndarray) -> Tensor:
        """Return the values of splines at one time."""
        return twin.spline(controls, knot, weights)

    def offsets(
        self, controls: tuple[Tensor, Tensor], knot: int, weights: np.ndarray, skin: Skin, unit: float
    ) -> tuple[Tensor, Tensor]:
        """Return dx and dq at one time."""
        return twin.offsets(controls, knot, weights, skin, unit)

    def offsets_gradient(
        self, d_dx: Tensor, d_dq: Tensor, skin: Skin, nodes: int, unit: float
    ) -> tuple[Tensor, Tensor]:
        """Return the gradients to the splines of nodes and points."""
        return twin.offsets_gradient(d_dx, d_dq, skin, nodes, unit)

    def adam(self, steps: Sequence[Step]) -> None:
        """Take steps of Adam in place."""
        twin.adam(steps)

    def catch_up(self, missed: Missed) -> None:
        """Take missed steps of Adam in place."""
        twin.catch_up(missed)


def antialiased(opacities: Tensor, conics: Tensor) -> Tensor:
    """Return opacities [N] reduced by the area that antialiasing adds to splats with conics [N, 3].

    Without this factor a splat thinner than a pixel covers as much as one of a pixel, and images of other sizes than the training
    images look too thick or too thin. The factor is sqrt(det C / det(C + 0.1)).

    Source: Mip-Splatting, section 4.2 (gsplat's `antialiased` uses 0.3).
    """
    return opacities * kept_area(*conics.unbind(1)).clamp_min(1e-6).sqrt()
