"""CUDA kernels: gsplat's, behind the signatures of `splat`."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from splatreel.errors import MissingDependencyError

TILE = 16


def _gsplat():
    try:
        import gsplat
    except ImportError as error:
        raise MissingDependencyError(
            "Tensors are on CUDA, but gsplat is not installed. Run `pip install splatreel[cuda]`, or use --device cpu."
        ) from error
    return gsplat


def project(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    viewmat: Tensor | np.ndarray,
    K: Tensor | np.ndarray,
    width: int,
    height: int,
    near: float,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """As `splat.project`. gsplat leaves the rows of culled Gaussians unset: they are made zero here."""
    pose = torch.as_tensor(viewmat, dtype=torch.float32, device=means.device)[None]
    lens = torch.as_tensor(K, dtype=torch.float32, device=means.device)[None]
    radii, means2d, depths, conics, _ = _gsplat().fully_fused_projection(
        means, None, quats, scales, pose, lens, width, height, eps2d=0.3, near_plane=near
    )
    radii = radii[0].amax(-1).int()
    seen = radii > 0
    zero = torch.zeros((), device=means.device)
    means2d = torch.where(seen[:, None], means2d[0], zero)
    conics = torch.where(seen[:, None], conics[0], zero)
    return means2d, conics, torch.where(seen, depths[0], zero), radii


def spherical_harmonics(degree: int, directions: Tensor, coefficients: Tensor) -> Tensor:
    return _gsplat().spherical_harmonics(degree, directions, coefficients)


def rasterize(
    means2d: Tensor,
    conics: Tensor,
    colors: Tensor,
    opacities: Tensor,
    depths: Tensor,
    radii: Tensor,
    width: int,
    height: int,
) -> tuple[Tensor, Tensor]:
    gsplat = _gsplat()
    tiles_x, tiles_y = -(-width // TILE), -(-height // TILE)
    extents = radii[None, :, None].expand(-1, -1, 2).contiguous()
    _, pairs, ids = gsplat.isect_tiles(means2d.detach()[None], extents, depths.detach()[None], TILE, tiles_x, tiles_y)
    offsets = gsplat.isect_offset_encode(pairs, 1, tiles_x, tiles_y)
    image, alpha = gsplat.rasterize_to_pixels(
        means2d[None], conics[None], colors[None], opacities[None], width, height, TILE, offsets, ids
    )
    return image[0], alpha[0, ..., 0]
