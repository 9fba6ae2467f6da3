"""Differentiable Gaussian splatting on torch tensors.

The tensors' device picks the backend: numba kernels with hand-written gradients on the CPU, gsplat on CUDA. Both follow gsplat's rules.
0.3 px^2 is added to the diagonal of the 2D covariance. Alpha is min(0.999, opacity exp(-sigma)), and alphas below 1/255 are skipped.
A pixel is full once its transmittance would fall to 1e-4. Pixel centers are at +0.5. `twin` has a readable torch version of every
function with the same signature, which the tests compare with.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from splatreel.base.errors import GaussiansError
from splatreel.kernels import neighbors
from splatreel.kernels.backend import Pinhole, antialiased
from splatreel.kernels.backends import backend_of
from splatreel.kernels.projected import FrozenSplats, Projection, Splats

__all__ = ["antialiased"]


class Rendered(NamedTuple):
    """An image of Gaussians.

    image: [H, W, 3] over black. alpha: [H, W]. means2d: [N, 2] pixels, part of the graph. radii: [N] int32, 0 for culled Gaussians.
    """

    image: Tensor
    alpha: Tensor
    means2d: Tensor
    radii: Tensor


def project(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    viewmat: Tensor | np.ndarray,
    K: Tensor | np.ndarray,
    width: int,
    height: int,
    near: float = 0.01,
    antialias: bool = False,
) -> Projection:
    """Project Gaussians to an image.

    Args:
        means: [N, 3] world.
        quats: [N, 4] wxyz of any length; gradients go through the normalization.
        scales: [N, 3] standard deviations, world units.
        viewmat: [4, 4] world to camera; gets no gradient.
        K: [3, 3] pixels; gets no gradient.
        width: Pixels.
        height: Pixels.
        near: Smallest depth drawn, world units.
        antialias: Add 0.1 px^2 to the covariance instead of 0.3, for opacities that are `antialiased`.

    Raises:
        GaussiansError: A value is NaN or infinite.
    """
    _check_finite(means=means, quats=quats, scales=scales)
    return backend_of(means).project(means, quats, scales, viewmat, K, width, height, near, antialias)


def spherical_harmonics(degree: int, directions: Tensor, coefficients: Tensor) -> Tensor:
    """Return the sum [N, 3] of the harmonics up to a degree in the 3DGS order, without the 0.5 of 3DGS colors.

    Args:
        degree: 0..3.
        directions: [N, 3] of any length, from the camera to the point.
        coefficients: [N, K, 3], K >= (degree + 1)^2.

    Raises:
        GaussiansError: There are too few coefficients for the degree.
    """
    if not 0 <= degree <= 3 or coefficients.shape[1] < (degree + 1) ** 2:
        raise GaussiansError(
            f"SH degree {degree} needs {(degree + 1) ** 2} coefficients, there are {coefficients.shape[1]}; choose 0..3."
        )
    return backend_of(coefficients).spherical_harmonics(degree, directions, coefficients)


def view_colors(means: Tensor, center: Tensor, base: Tensor, rest: Tensor) -> Tensor:
    """Return the colors [N, 3] of points seen from a camera: 0.5 plus the harmonics, at least 0.

    Args:
        means: [N, 3]; gets no gradient.
        center: [3], the camera's position; gets no gradient.
        base: [N, 1, 3], the first coefficients.
        rest: [N, K - 1, 3], the other coefficients in the 3DGS order; K is 1, 4, 9 or 16.
    """
    return backend_of(means).view_colors(means, center, base, rest)


def deformed(
    points: Sequence[Tensor],
    offsets: tuple[Tensor, Tensor] | None,
    shade: Tensor | None,
    pinhole: Pinhole,
    center: Tensor,
    near: float,
    antialias: bool = False,
) -> Splats:
    """Deform points, project them and compute their colors.

    Args:
        points: means [N, 3], quats [N, 4], log_scales [N, 3], logit_opacities [N], sh_base [N, 1, 3] and sh_rest [N, K - 1, 3].
        offsets: dx [N, 3] and dq [N, 4] of any length. The result has means x + dx and quats q * dq. None: no motion.
        shade: [N, 4], added to c_base and to the logit of the opacity. None: no change.
        pinhole: viewmat, K, width and height, as for `project`.
        center: [3], the camera's position.
        near: Smallest depth drawn, world units.
        antialias: See `antialiased`.

    Raises:
        GaussiansError: A value is NaN or infinite.

    Source: paper, section 4.2.
    """
    means, quats, log_scales, *_ = points
    moved = {} if offsets is None else {"dx": offsets[0], "dq": offsets[1]}
    _check_finite(means=means, quats=quats, log_scales=log_scales, **moved)
    return backend_of(means).deform(points, offsets, shade, pinhole, center, near, antialias)


def rasterize(splats: Splats, width: int, height: int, absolute: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """Blend projected Gaussians front to back over black. Return the image [H, W, C] and alpha [H, W].

    Args:
        splats: N splats.
        width: Pixels.
        height: Pixels.
        absolute: [N, 2] zeros. Their gradient is the sum of the absolute gradients of `means2d`: over tiles of 16 x 16 pixels and
            every three channels on the CPU, over pixels on CUDA. Gradients that cancel each other count, as missing detail does.

    Raises:
        GaussiansError: A value is NaN or infinite.

    Source: Ye et al. 2024, "AbsGS: Recovering fine details for 3D Gaussian Splatting", for `absolute`.
    """
    _check_splats(splats)
    return backend_of(splats.means2d).rasterize(splats, width, height, absolute)


def freeze(splats: Splats, width: int, height: int) -> FrozenSplats:
    """Draw splats that will not change, with colors [M, 3], for `rasterize_among`.

    Raises:
        GaussiansError: A value is NaN or infinite.
    """
    _check_splats(splats)
    return backend_of(splats.means2d).freeze(splats, width, height)


def remove(frozen: FrozenSplats, gone: Tensor) -> FrozenSplats:
    """Return frozen splats without some of them. On the CPU this is the same object, redrawn where the removed splats were.

    Args:
        frozen: The splats.
        gone: [K] int64, rows of the splats that `freeze` drew, no matter what was removed before.
    """
    return backend_of(frozen.image).remove(frozen, gone)


def rasterize_among(splats: Splats, frozen: FrozenSplats) -> tuple[Tensor, Tensor, Tensor]:
    """Blend projected Gaussians with frozen splats, in the order of all their depths. Only tiles that they touch are drawn again.

    The image and the gradients equal those of `rasterize` of all splats together.

    Args:
        splats: N splats with colors [N, 3].
        frozen: What `freeze` returned.

    Returns:
        The image [H, W, 3], alpha [H, W], and tiles [ceil(H / 16), ceil(W / 16)] bool: the tiles that were drawn again.

    Raises:
        GaussiansError: A value is NaN or infinite.
    """
    _check_splats(splats)
    return backend_of(splats.means2d).rasterize_among(splats, frozen)


def render(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    sh: Tensor,
    viewmat: Tensor | np.ndarray,
    K: Tensor | np.ndarray,
    width: int,
    height: int,
    *,
    near: float = 0.01,
    degree: int | None = None,
    antialias: bool = False,
) -> Rendered:
    """Render Gaussians with colors in spherical harmonics.

    Call `means2d.retain_grad()` on the result before backward to get screen-space gradients, in loss per pixel.

    Args:
        means: [N, 3] world.
        quats: [N, 4] wxyz.
        scales: [N, 3] standard deviations, world units.
        opacities: [N], 0..1.
        sh: [N, K, 3].
        viewmat: [4, 4] world to camera.
        K: [3, 3] pixels.
        width: Pixels.
        height: Pixels.
        near: Smallest depth drawn, world units.
        degree: SH degree used. None: all that `sh` has.
        antialias: See `antialiased`.
    """
    bands = round(sh.shape[1] ** 0.5) - 1 if degree is None else degree
    projection = project(means, quats, scales, viewmat, K, width, height, near, antialias)
    pose = torch.as_tensor(viewmat, dtype=torch.float32, device=means.device)
    center = -pose[:3, :3].T @ pose[:3, 3]
    colors = (spherical_harmonics(bands, means - center, sh) + 0.5).clamp_min(0)
    if antialias:
        opacities = antialiased(opacities, projection.conics)
    image, alpha = rasterize(projection.colored(colors, opacities), width, height)
    return Rendered(image, alpha, projection.means2d, projection.radii)


def photometric_loss(
    image: Tensor, target: Tensor, lambda_dssim: float = 0.2, gain: Tensor | None = None, tiles: Tensor | None = None
) -> Tensor:
    """Return (1 - lambda) mean|image * gain - target| + lambda (1 - mean SSIM).

    SSIM has an 11 x 11 Gaussian window of sigma 1.5 and zero padding.

    Args:
        image: [H, W, 3], 0..1.
        target: [H, W, 3], float 0..1 or uint8; gets no gradient.
        lambda_dssim: Weight of the SSIM term.
        gain: [3], factors of the channels. None: 1.
        tiles: [ceil(H / 16), ceil(W / 16)] bool, the only tiles that change, as `rasterize_among` returns them. The loss may then
            differ by a constant. Pixels outside these tiles get no gradient, and `gain` must not require one. None: all tiles.

    Raises:
        GaussiansError: The shapes do not fit, or a gain with a gradient is combined with tiles.

    Source: 3D Gaussian Splatting, section 5.1.
    """
    if image.shape != target.shape or image.shape[-1] != 3:
        shapes = f"image {tuple(image.shape)}, target {tuple(target.shape)}"
        raise GaussiansError(f"photometric_loss: {shapes}; both must be [H, W, 3].")
    if tiles is not None and gain is not None and gain.requires_grad:
        raise GaussiansError(
            "photometric_loss: the gradient of a gain needs all tiles; pass no tiles, or gain.detach()."
        )
    return backend_of(image).photometric_loss(image, target, lambda_dssim, gain, tiles)


def layered_loss(
    splats: Splats,
    frozen: FrozenSplats,
    target: Tensor,
    lambda_dssim: float = 0.2,
    gain: Tensor | None = None,
    background: Tensor | None = None,
    where: Tensor | None = None,
) -> Tensor:
    """Return the `photometric_loss` of splats drawn among frozen splats, up to a constant. Only the redrawn tiles are compared.

    This is much faster than `rasterize_among` and `photometric_loss` where few tiles change. Two threads must not call it for the same
    frozen splats at once.

    Args:
        splats: N splats with colors [N, 3].
        frozen: What `freeze` returned.
        target: [H, W, 3], float 0..1 or uint8; gets no gradient.
        lambda_dssim: Weight of the SSIM term.
        gain: [3], factors of the channels; gets no gradient.
        background: [3], added to the image before the gain; gets no gradient.
        where: [N] bool. If given, the splats are the whole scene, with the frozen splats among them, and all splats get gradients. The
            tiles that one of the marked splats touches are compared. Splats that move must be marked. None: draw among `frozen`.

    Raises:
        GaussiansError: A value is NaN or infinite.
    """
    _check_splats(splats)
    return backend_of(splats.means2d).layered_loss(splats, frozen, target, lambda_dssim, gain, background, where)


def gather(projection: Projection, opacities: Tensor, images: Tensor) -> Tensor:
    """Return the sum of images over the pixels of each splat, [N, K], weighted by the splat's share of each pixel.

    The sum is the gradient of a drawn image with respect to the colors of the splats. It takes less time than this gradient, because
    the gradients with respect to all other properties are left out. The result has no gradient.

    Args:
        projection: N projected points.
        opacities: [N], 0..1.
        images: [H, W, K].

    Raises:
        GaussiansError: A value is NaN or infinite.
    """
    check_finite(means2d=projection.means2d, conics=projection.conics, opacities=opacities)
    return backend_of(projection.means2d).gather(projection, opacities, images)


def nearest_neighbors(points: Tensor, k: int, queries: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """Return the k nearest points of each query: indices [Q, k] int64 and distances [Q, k], nearest first.

    Args:
        points: [N, 3].
        k: Number of neighbors.
        queries: [Q, 3]. None: the points themselves, without each point's match with itself.

    Raises:
        GaussiansError: There are fewer than k points.
    """
    available = len(points) - (queries is None)
    if not 1 <= k <= available:
        raise GaussiansError(f"nearest_neighbors: asked for {k} neighbors where there are {available}.")
    return neighbors.nearest_neighbors(points, k, queries)


def _check_splats(splats: Splats) -> None:
    """Check everything that gets gradients, as `_check_finite` does."""
    _check_finite(means2d=splats.means2d, conics=splats.conics, colors=splats.colors, opacities=splats.opacities)


def _check_finite(**tensors: Tensor) -> None:
    """Check inputs, except those that a GPU trains on: looking at them would wait for the GPU. Training calls `check_finite`."""
    if not torch.is_grad_enabled() or not any(tensor.is_cuda and tensor.requires_grad for tensor in tensors.values()):
        check_finite(**tensors)


def check_finite(**tensors: Tensor) -> None:
    """Check that tensors hold no NaN and no infinity.

    Raises:
        GaussiansError: One does. The error names the tensor.
    """
    for name, tensor in tensors.items():
        values = tensor.detach()
        # The sum is quick, but may overflow.
        if not math.isfinite(values.sum().item()) and not torch.isfinite(values).all():
            bad = int((~torch.isfinite(values)).sum())
            raise GaussiansError(
                f"Gaussians: {name} holds {bad} values that are NaN or infinite; lower the learning rate."
            )
