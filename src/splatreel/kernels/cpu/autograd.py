"""The CPU kernels as torch autograd functions. Tensors and arrays share memory without copies.

Every tensor that a gradient needs goes through `save_for_backward`, so that torch notices if one is changed in place before the
backward pass. Each call has its own buffers, so that any number of renders can wait for their backward passes.
"""

# pyright: reportIncompatibleMethodOverride=false
# (torch types `backward` as taking any number of gradients)

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable

from splatreel.kernels.cpu import binning, deform, harmonics, hashgrid, layered, motion, project, rasterize, similarity
from splatreel.kernels.projected import Projection, Splats

CHUNK = 3
"""Channels that the rasterizer blends in one pass. Other counts are padded and take several passes."""


def _arrays(*tensors: Tensor) -> list[np.ndarray]:
    return [_array(tensor) for tensor in tensors]


def _array(tensor: Tensor) -> np.ndarray:
    if tensor.dtype != torch.float32:
        tensor = tensor.to(torch.float32)
    return tensor.detach().contiguous().numpy()


def _gradient(found: Tensor | None, values: np.ndarray) -> np.ndarray:
    """Return a gradient as an array, with zeros if the loss does not depend on the values."""
    return _array(found) if found is not None else rasterize.no_gradient(values.shape)


def _tensors(*arrays: np.ndarray) -> list[Tensor]:
    return [torch.from_numpy(array) for array in arrays]


class Project(Function):
    """Projection of Gaussians, see `splat.project`."""

    @staticmethod
    def forward(ctx: Any, means: Tensor, quats: Tensor, scales: Tensor, view: project.Pinhole):
        means2d, conics, depths, radii = _tensors(*project.forward(*_arrays(means, quats, scales), view=view))
        ctx.view = view
        ctx.save_for_backward(means, quats, scales, conics, radii)
        ctx.mark_non_differentiable(radii)
        return means2d, conics, depths, radii

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, d_means2d: Tensor, d_conics: Tensor, d_depths: Tensor, _: None):
        means, quats, scales, conics, radii = ctx.saved_tensors
        arrays = _arrays(means, quats, scales, conics, d_means2d, d_conics, d_depths)
        return *_tensors(*project.backward(*arrays, radii=radii.numpy(), view=ctx.view)), None


class SphericalHarmonics(Function):
    """Spherical harmonics, see `splat.spherical_harmonics`."""

    @staticmethod
    def forward(ctx: Any, degree: int, directions: Tensor, coefficients: Tensor):
        ctx.degree = degree
        ctx.save_for_backward(directions, coefficients)
        return torch.from_numpy(harmonics.forward(degree, *_arrays(directions, coefficients)))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, d_colors: Tensor):
        arrays, wanted = _arrays(*ctx.saved_tensors, d_colors), ctx.needs_input_grad[1]
        d_directions, d_coefficients = harmonics.backward(ctx.degree, *arrays, to_directions=wanted)
        return None, None if d_directions is None else torch.from_numpy(d_directions), torch.from_numpy(d_coefficients)


class ViewColors(Function):
    """Colors seen from a camera, see `splat.view_colors`."""

    @staticmethod
    def forward(ctx: Any, means: Tensor, center: Tensor, base: Tensor, rest: Tensor):
        colors = torch.from_numpy(harmonics.colors(*_arrays(means, center, base, rest)))
        ctx.save_for_backward(means, center, colors, rest)
        return colors

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, d_colors: Tensor):
        return None, None, *_tensors(*harmonics.colors_backward(*_arrays(*ctx.saved_tensors, d_colors)))


class Deformed(Function):
    """Deformation, projection and colors in one pass, see `splat.deformed`."""

    @staticmethod
    def forward(ctx: Any, view: project.Pinhole, center: Tensor, dx, dq, shade, *points: Tensor):
        ctx.given = [change is not None for change in (dx, dq, shade)]
        none = (points[0].new_zeros(0, size) for size in (3, 4, 4))
        changes = [change if change is not None else rows for change, rows in zip((dx, dq, shade), none, strict=True)]
        ctx.view, saved = view, (*points, *changes, center)
        *moment, middle = _arrays(*saved)
        opacities, ctx.seen = deform.forward(deform.DeformedPoints(*moment), middle, view)
        ctx.save_for_backward(*saved)
        means2d, conics, colors, depths, radii = _tensors(*ctx.seen[:5])
        ctx.mark_non_differentiable(depths, radii)
        return means2d, conics, colors, torch.from_numpy(opacities), depths, radii

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *d_splats: Tensor):
        *moment, center = _arrays(*ctx.saved_tensors)
        found = deform.backward(deform.DeformedPoints(*moment), ctx.seen, center, ctx.view, *_arrays(*d_splats[:4]))
        *d_points, d_dq, d_shade = _tensors(*found)
        d_changes = [d if given else None for d, given in zip((d_points[0], d_dq, d_shade), ctx.given, strict=True)]
        return None, None, *d_changes, *d_points


class Rasterize(Function):
    """Blending of projected Gaussians, see `splat.rasterize`."""

    @staticmethod
    def forward(ctx: Any, means2d, conics, colors, opacities, depths, radii, width: int, height: int, absolute):
        del absolute  # only its gradient counts
        bins = _bins(means2d, conics, opacities, depths, radii, width, height)
        parts = [rasterize.forward(bins, part) for part in _split(*_arrays(colors))]
        image = torch.from_numpy(_join([image for image, _ in parts], colors.shape[1]))
        alpha = torch.from_numpy(parts[0][1])
        ctx.bins = bins
        ctx.set_materialize_grads(False)
        ctx.save_for_backward(colors, image, alpha)
        return image, alpha

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, d_image: Tensor | None, d_alpha: Tensor | None):
        colors, image, alpha = _arrays(*ctx.saved_tensors)
        d_image_, d_alpha_ = _gradient(d_image, image), _gradient(d_alpha, alpha)
        parts = []
        for part in zip(_split(colors), _split(image), _split(d_image_), strict=True):
            parts.append(rasterize.backward(ctx.bins, *part, alpha=alpha, d_alpha=d_alpha_))
            d_alpha_ = np.zeros_like(d_alpha_)  # all parts share one alpha: count its gradient once
        total = parts[0] if len(parts) == 1 else rasterize.Gradients(*(np.sum(c, 0) for c in zip(*parts, strict=True)))
        d_colors = _join([part.colors for part in parts], colors.shape[1])
        gradients = _tensors(total.means2d, total.conics, d_colors, total.opacities)
        return *gradients, *[None] * 4, torch.from_numpy(total.absolute) if ctx.needs_input_grad[8] else None


class RasterizeAmong(Function):
    """Blending among frozen splats, see `splat.rasterize_among`."""

    @staticmethod
    def forward(ctx: Any, means2d, conics, colors, opacities, depths, radii, frozen: rasterize.Frozen):
        height, width = frozen.alpha.shape
        bins = _bins(means2d, conics, opacities, depths, radii, width, height)
        image, alpha = _tensors(*rasterize.forward(bins, *_arrays(colors), frozen=frozen))
        tiles = torch.from_numpy(bins.counts.reshape(-(-height // binning.TILE), -1) > 0)
        ctx.bins, ctx.frozen = bins, frozen
        ctx.set_materialize_grads(False)
        ctx.save_for_backward(colors, image, alpha)
        ctx.mark_non_differentiable(tiles)
        return image, alpha, tiles

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, d_image: Tensor | None, d_alpha: Tensor | None, _: None):
        colors, image, alpha = _arrays(*ctx.saved_tensors)
        d_image_, d_alpha_ = _gradient(d_image, image), _gradient(d_alpha, alpha)
        found = rasterize.backward(ctx.bins, colors, image, d_image_, alpha, d_alpha_, ctx.frozen)
        return *_tensors(found.means2d, found.conics, found.colors, found.opacities), None, None, None


class LayeredLoss(Function):
    """Photometric loss of splats among frozen splats, see `splat.layered_loss`. The forward pass computes the gradients too."""

    @staticmethod
    def forward(
        ctx: Any, means2d, conics, colors, opacities, depths, radii, frozen: rasterize.Frozen, target: Tensor, *rest
    ):
        lambda_dssim, gain, background, where = rest
        height, width = frozen.alpha.shape
        bins = _bins(means2d, conics, opacities, depths, radii, width, height)
        given = [None if value is None else _array(value) for value in (gain, background)]
        chosen = None if where is None else where.numpy()
        loss, found = layered.loss_and_gradient(
            bins, _array(colors), frozen, target.contiguous().numpy(), lambda_dssim, *given, where=chosen
        )
        ctx.gradients = _tensors(found.means2d, found.conics, found.colors, found.opacities)
        return torch.tensor(loss, dtype=torch.float32)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, d_loss: Tensor):
        gradients = ctx.gradients if float(d_loss) == 1 else [gradient * d_loss for gradient in ctx.gradients]
        return *gradients, *[None] * 8


def gather(projection: Projection, opacities: Tensor, images: Tensor) -> Tensor:
    """Return the sums of images over the pixels of splats, see `gather.gather`. It has no gradient."""
    height, width = images.shape[:2]
    means2d, conics, depths, radii = projection
    bins = _bins(means2d, conics, opacities, depths, radii, width, height)
    return torch.from_numpy(rasterize.gather(bins, _array(images)))


def freeze(splats: Splats, width: int, height: int) -> rasterize.Frozen:
    """Sort splats with colors [M, 3] into tiles and draw them once."""
    means2d, conics, colors, opacities, depths, radii = splats
    bins, values = _bins(means2d, conics, opacities, depths, radii, width, height), _array(colors)
    return rasterize.Frozen(bins, values, *rasterize.forward(bins, values))


def remove(frozen: rasterize.Frozen, gone: Tensor) -> None:
    """Remove splats [K] int64 from frozen splats, in place."""
    rasterize.remove(frozen, gone.numpy())


def _bins(means2d, conics, opacities, depths, radii, width: int, height: int) -> binning.Bins:
    visible = radii.to(torch.int32).contiguous().numpy()
    return binning.bin_splats(*_arrays(means2d, conics, opacities, depths), radii=visible, width=width, height=height)


def _split(values: np.ndarray) -> list[np.ndarray]:
    """Divide values [..., C] into parts of three channels, the last one padded with zeros."""
    channels = values.shape[-1]
    if channels == CHUNK:
        return [values]
    padded = np.pad(values, [(0, 0)] * (values.ndim - 1) + [(0, -channels % CHUNK)])
    return [np.ascontiguousarray(padded[..., k : k + CHUNK]) for k in range(0, channels, CHUNK)]


def _join(parts: list[np.ndarray], channels: int) -> np.ndarray:
    """Undo `_split`."""
    return parts[0] if channels == CHUNK else np.ascontiguousarray(np.concatenate(parts, -1)[..., :channels])


class PhotometricLoss(Function):
    """Photometric loss, see `splat.photometric_loss`. The forward pass computes the gradients too."""

    @staticmethod
    def forward(
        ctx: Any, image: Tensor, target: Tensor, lambda_dssim: float, gain: Tensor | None, tiles: Tensor | None
    ):
        arrays = (
            _arrays(image)[0],
            target.contiguous().numpy(),
            lambda_dssim,
            None if gain is None else _arrays(gain)[0],
        )
        wanted = None if tiles is None else tiles.numpy()
        ctx.found = similarity.loss_and_gradient(*arrays, tiles=wanted)
        return torch.tensor(ctx.found.loss, dtype=torch.float32)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, d_loss: Tensor):
        d_image, d_gain = _tensors(ctx.found.d_image, ctx.found.d_gain)
        if float(d_loss) != 1:
            d_image, d_gain = d_image * d_loss, d_gain * d_loss
        return d_image, None, None, d_gain if ctx.needs_input_grad[3] else None, None


class HashGrid(Function):
    """Features of a hash grid, see `motion.hashgrid`."""

    @staticmethod
    def forward(ctx: Any, coords: Tensor, table: Tensor, resolutions: np.ndarray):
        ctx.resolutions = resolutions
        ctx.save_for_backward(coords, table)
        return torch.from_numpy(hashgrid.forward(*_arrays(coords, table), resolutions=resolutions))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, d_features: Tensor):
        arrays = _arrays(*ctx.saved_tensors, d_features)
        d_coords = d_table = None
        if ctx.needs_input_grad[0]:
            d_coords = torch.from_numpy(hashgrid.coords_gradient(*arrays, resolutions=ctx.resolutions))
        if ctx.needs_input_grad[1]:
            d_table = torch.from_numpy(hashgrid.table_gradient(*arrays, resolutions=ctx.resolutions))
        return d_coords, d_table, None


class Arap(Function):
    """As-rigid-as-possible loss, see `motion.arap`. The forward pass computes the gradients too."""

    @staticmethod
    def forward(ctx: Any, means: Tensor, dx: Tensor, dq: Tensor, neighbor: Tensor, weights: Tensor, unit: float):
        arrays = *_arrays(means, dx, dq), neighbor.contiguous().numpy(), *_arrays(weights)
        loss, *gradients = motion.arap(*arrays, unit=unit)
        ctx.gradients = _tensors(*gradients)
        return torch.tensor(loss, dtype=torch.float32)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, d_loss: Tensor):
        d_dx, d_dq = ctx.gradients
        if float(d_loss) != 1:
            d_dx, d_dq = d_dx * d_loss, d_dq * d_loss
        return None, d_dx, d_dq, None, None, None
