"""The CPU backend: numba kernels with hand-written gradients."""

# pyright: reportReturnType=false
# (torch types `Function.apply` as returning nothing in particular)

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from splatreel.kernels.backend import Backend, Pinhole
from splatreel.kernels.cpu import adam, autograd, motion, project
from splatreel.kernels.cpu.project import BLUR, FINE_BLUR
from splatreel.kernels.projected import FrozenSplats, Projection, Splats
from splatreel.kernels.twin import Missed, Skin, Step


class CpuBackend(Backend):
    """Kernels for CPU tensors. Tensors and numpy arrays share their memory."""

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
        view = _view(viewmat, K, width, height, near, antialias)
        return Projection(*autograd.Project.apply(means, quats, scales, view))

    def spherical_harmonics(self, degree: int, directions: Tensor, coefficients: Tensor) -> Tensor:
        return autograd.SphericalHarmonics.apply(degree, directions, coefficients)

    def view_colors(self, means: Tensor, center: Tensor, base: Tensor, rest: Tensor) -> Tensor:
        return autograd.ViewColors.apply(means.detach(), center, base, rest)

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
        view = _view(*pinhole, near, antialias)
        return Splats(*autograd.Deformed.apply(view, center, *(offsets or (None, None)), shade, *points))

    def rasterize(
        self, splats: Splats, width: int, height: int, absolute: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        return autograd.Rasterize.apply(*splats, width, height, absolute)

    def gather(self, projection: Projection, opacities: Tensor, images: Tensor) -> Tensor:
        return autograd.gather(projection, opacities, images)

    def freeze(self, splats: Splats, width: int, height: int) -> FrozenSplats:
        held = autograd.freeze(splats, width, height)
        return FrozenSplats(torch.from_numpy(held.image), torch.from_numpy(held.alpha), held)

    def remove(self, frozen: FrozenSplats, gone: Tensor) -> FrozenSplats:
        autograd.remove(frozen.held, gone)
        return frozen

    def rasterize_among(self, splats: Splats, frozen: FrozenSplats) -> tuple[Tensor, Tensor, Tensor]:
        return autograd.RasterizeAmong.apply(*splats, frozen.held)

    def photometric_loss(
        self, image: Tensor, target: Tensor, lambda_dssim: float, gain: Tensor | None, tiles: Tensor | None
    ) -> Tensor:
        return autograd.PhotometricLoss.apply(image, target, lambda_dssim, gain, tiles)

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
        return autograd.LayeredLoss.apply(*splats, frozen.held, target, lambda_dssim, gain, background, where)

    def hashgrid(self, coords: Tensor, table: Tensor, resolutions: np.ndarray) -> Tensor:
        return autograd.HashGrid.apply(coords, table, resolutions)

    def arap(self, means: Tensor, dx: Tensor, dq: Tensor, neighbor: Tensor, weights: Tensor, unit: float) -> Tensor:
        return autograd.Arap.apply(means, dx, dq, neighbor, weights, unit)

    def spline(self, controls: Tensor, knot: int, weights: np.ndarray) -> Tensor:
        return torch.from_numpy(motion.spline(controls.numpy()[knot : knot + 4], weights))

    def offsets(
        self, controls: tuple[Tensor, Tensor], knot: int, weights: np.ndarray, skin: Skin, unit: float
    ) -> tuple[Tensor, Tensor]:
        nodes, points = (level.numpy()[knot : knot + 4] for level in controls)
        dx, dq = motion.offsets(nodes, points, weights, (skin[0].numpy(), skin[1].numpy()), unit)
        return torch.from_numpy(dx), torch.from_numpy(dq)

    def offsets_gradient(
        self, d_dx: Tensor, d_dq: Tensor, skin: Skin, nodes: int, unit: float
    ) -> tuple[Tensor, Tensor]:
        arrays = d_dx.contiguous().numpy(), d_dq.contiguous().numpy(), (skin[0].numpy(), skin[1].numpy())
        d_nodes, d_points = motion.offsets_gradient(*arrays, nodes, unit)
        return torch.from_numpy(d_nodes), torch.from_numpy(d_points)

    def adam(self, steps: Sequence[Step]) -> None:
        adam.step([_flat(step) for step in steps])

    def catch_up(self, missed: Missed) -> None:
        trained, begin, *columns = missed
        size = trained.parameter[0].numel() if len(trained.parameter) else 0
        adam.catch_up([array[begin * size : (begin + len(missed.lengths)) * size] for array in trained.flat], columns)


def _view(
    viewmat: Tensor | np.ndarray, K: Tensor | np.ndarray, width: int, height: int, near: float, antialias: bool
) -> project.Pinhole:
    return project.Pinhole(_matrix(viewmat), _matrix(K), width, height, near, FINE_BLUR if antialias else BLUR)


def _matrix(value: Tensor | np.ndarray) -> np.ndarray:
    if isinstance(value, Tensor):
        value = value.detach().cpu().numpy()
    return np.ascontiguousarray(value, np.float32)


def _flat(step: Step) -> adam.Flat:
    """Return a step with flat arrays in place of tensors."""
    gradient, begin, end = step.gradient, step.begin, step.end
    size = gradient[0].numel() if len(gradient) else 0
    parameter, mean, square = step.trained.flat
    if begin or end < len(step.trained.parameter):
        parameter, mean, square = (array[begin * size : end * size] for array in (parameter, mean, square))
    slope = gradient.contiguous().numpy().reshape(-1)
    return adam.Flat(parameter, mean, square, slope, step.factors, (step.start - begin) * size, step.moment)
