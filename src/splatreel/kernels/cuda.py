"""CUDA kernels: gsplat's, behind the signatures of `splat`."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from splatreel.errors import MissingDependencyError
from splatreel.kernels import twin

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
    still: Any = None,
) -> tuple[Tensor, Tensor]:
    """As `splat.rasterize`; gsplat skips the tiles a mask leaves out."""
    gsplat = _gsplat()
    tiles_x, tiles_y = -(-width // TILE), -(-height // TILE)
    extents = radii[None, :, None].expand(-1, -1, 2).contiguous()
    _, pairs, ids = gsplat.isect_tiles(means2d.detach()[None], extents, depths.detach()[None], TILE, tiles_x, tiles_y)
    offsets = gsplat.isect_offset_encode(pairs, 1, tiles_x, tiles_y)
    masks = None if still is None else still.tiles[None].contiguous()
    image, alpha = gsplat.rasterize_to_pixels(
        means2d[None], conics[None], colors[None], opacities[None], width, height, TILE, offsets, ids, masks=masks
    )
    image, alpha = image[0], alpha[0, ..., 0]
    return (image, alpha) if still is None else twin.keep_still(image, alpha, still)


def tile_spans(means2d: Tensor, radii: Tensor, width: int, height: int) -> Tensor:
    """As `splat.tile_spans`, from the square of the radius, which is what gsplat sorts into tiles by."""
    low = ((means2d.detach() - radii[:, None]) / TILE).floor().long()
    high = ((means2d.detach() + radii[:, None]) / TILE).floor().long()
    columns, rows = -(-width // TILE), -(-height // TILE)
    left, right = low[:, 0].clamp_min(0), high[:, 0].clamp_max(columns - 1)
    top, bottom = low[:, 1].clamp_min(0), high[:, 1].clamp_max(rows - 1)
    seen = (radii > 0) & (right >= left) & (bottom >= top)
    empty = torch.tensor([0, -1, 0, -1], device=means2d.device)
    return torch.where(seen[:, None], torch.stack([left, right, top, bottom], 1), empty)
