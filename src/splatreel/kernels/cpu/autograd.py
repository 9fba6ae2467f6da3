"""The CPU kernels as torch autograd functions. Tensors and arrays share memory; nothing is copied."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from splatreel.kernels.cpu import binning, harmonics, hashgrid, project, rasterize, similarity

CHUNK = 3  # channels the rasteriser blends at once; other counts are padded and done in several passes


def _array(tensor: Tensor) -> np.ndarray:
    return tensor.detach().to(torch.float32).contiguous().numpy()


def _tensors(*arrays: np.ndarray) -> tuple[Tensor, ...]:
    return tuple(torch.from_numpy(array) for array in arrays)


class Project(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, means: Tensor, quats: Tensor, scales: Tensor, viewmat, K, width, height, near):
        inputs = (_array(means), _array(quats), _array(scales), viewmat, K, width, height)
        means2d, conics, depths, radii = _tensors(*project.forward(*inputs, near))
        ctx.inputs = inputs
        ctx.save_for_backward(conics, radii)
        ctx.mark_non_differentiable(radii)
        return means2d, conics, depths, radii

    @staticmethod
    def backward(ctx: Any, *grads: Tensor):
        conics, radii = ctx.saved_tensors
        d_means2d, d_conics, d_depths, _ = grads
        arrays = (_array(d_means2d), _array(d_conics), _array(d_depths))
        return *_tensors(*project.backward(*ctx.inputs, _array(conics), _array(radii), arrays)), *[None] * 5


class SphericalHarmonics(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, degree: int, directions: Tensor, coefficients: Tensor):
        ctx.inputs = (degree, _array(directions), _array(coefficients))
        return torch.from_numpy(harmonics.forward(*ctx.inputs))

    @staticmethod
    def backward(ctx: Any, *grads: Tensor):
        return None, *_tensors(*harmonics.backward(*ctx.inputs, _array(grads[0])))


class Rasterize(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, means2d, conics, colors, opacities, depths, radii, width, height):
        bins = binning.bin_splats(
            _array(means2d),
            _array(conics),
            _array(opacities),
            _array(depths),
            np.ascontiguousarray(radii.numpy(), np.int32),
            width,
            height,
        )
        parts = _split(_array(colors))
        images, alphas = zip(*(rasterize.forward(bins, part) for part in parts), strict=True)
        alpha = alphas[0]
        image = images[0] if len(images) == 1 else np.concatenate(images, -1)[..., : colors.shape[1]]
        ctx.bins, ctx.parts, ctx.images, ctx.alpha = bins, parts, images, alpha
        return torch.from_numpy(image), torch.from_numpy(alpha)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor):
        d_image, d_alpha = _array(grads[0]), _array(grads[1])
        total, d_colors = None, []
        for part, image, d_part in zip(ctx.parts, ctx.images, _split(d_image), strict=True):
            *geometry, d_color = rasterize.backward(ctx.bins, part, image, ctx.alpha, d_part, d_alpha)
            total = geometry if total is None else [a + b for a, b in zip(total, geometry, strict=True)]
            d_colors.append(d_color)
            d_alpha = np.zeros_like(d_alpha)  # count the gradient to alpha once
        assert total is not None
        d_means2d, d_conics, d_opacities = _tensors(*total)
        d_color = torch.from_numpy(np.concatenate(d_colors, -1)[:, : d_image.shape[-1]])
        return d_means2d, d_conics, d_color, d_opacities, None, None, None, None


def _split(values: np.ndarray) -> list[np.ndarray]:
    """values [..., C] in parts the rasteriser takes: C 1 as it is, else threes, the last padded with zeros."""
    channels = values.shape[-1]
    if channels in (1, CHUNK):
        return [values]
    padded = np.pad(values, [(0, 0)] * (values.ndim - 1) + [(0, -channels % CHUNK)])
    return [np.ascontiguousarray(padded[..., k : k + CHUNK]) for k in range(0, channels, CHUNK)]


class PhotometricLoss(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, image: Tensor, target: Tensor, lambda_dssim: float):
        loss, ctx.d_image = similarity.loss_and_gradient(_array(image), _array(target), lambda_dssim)
        return torch.tensor(loss, dtype=torch.float32)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor):
        return torch.from_numpy(ctx.d_image) * grads[0], None, None


class HashGrid(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, coords: Tensor, table: Tensor, resolutions: np.ndarray):
        ctx.inputs = (_array(coords), _array(table), resolutions)
        return torch.from_numpy(hashgrid.forward(*ctx.inputs))

    @staticmethod
    def backward(ctx: Any, *grads: Tensor):
        need_coords, need_table, _ = ctx.needs_input_grad
        d_features = _array(grads[0])
        d_coords = torch.from_numpy(hashgrid.coords_gradient(*ctx.inputs, d_features)) if need_coords else None
        d_table = torch.from_numpy(hashgrid.table_gradient(*ctx.inputs, d_features)) if need_table else None
        return d_coords, d_table, None
