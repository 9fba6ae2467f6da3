"""CUDA kernels: gsplat's, behind the signatures of `splat`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as functional
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
    blur: float,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """As `splat.project`. gsplat leaves the rows of culled Gaussians unset: they are made zero here."""
    pose = torch.as_tensor(viewmat, dtype=torch.float32, device=means.device)[None]
    lens = torch.as_tensor(K, dtype=torch.float32, device=means.device)[None]
    radii, means2d, depths, conics, _ = _gsplat().fully_fused_projection(
        means, None, quats, scales, pose, lens, width, height, eps2d=blur, near_plane=near
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
    tiles: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """As `splat.rasterize`. tiles: [rows, columns] bool, the tiles to draw; gsplat skips the others."""
    gsplat = _gsplat()
    tiles_x, tiles_y = -(-width // TILE), -(-height // TILE)
    extents = radii[None, :, None].expand(-1, -1, 2).contiguous()
    _, pairs, ids = gsplat.isect_tiles(means2d.detach()[None], extents, depths.detach()[None], TILE, tiles_x, tiles_y)
    offsets = gsplat.isect_offset_encode(pairs, 1, tiles_x, tiles_y)
    masks = None if tiles is None else tiles[None].contiguous()
    image, alpha = gsplat.rasterize_to_pixels(
        means2d[None], conics[None], colors[None], opacities[None], width, height, TILE, offsets, ids, masks=masks
    )
    return image[0], alpha[0, ..., 0]


ProjectedSplats = tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]


@dataclass(frozen=True)
class Frozen:
    """ProjectedSplats that never change: tensors as `rasterize` takes them; spans: [M, 4] their tiles; image, alpha: their picture."""

    splats: ProjectedSplats
    spans: Tensor
    image: Tensor
    alpha: Tensor


def freeze(
    means2d: Tensor,
    conics: Tensor,
    colors: Tensor,
    opacities: Tensor,
    depths: Tensor,
    radii: Tensor,
    width: int,
    height: int,
) -> tuple[Tensor, Tensor, Frozen]:
    """As `splat.freeze`: image, alpha and what `rasterize_among` needs."""
    splats = means2d.detach(), conics.detach(), colors.detach(), opacities.detach(), depths, radii
    image, alpha = rasterize(*splats, width, height)
    return image, alpha, Frozen(splats, tile_spans(means2d, radii, width, height), image, alpha)


def rasterize_among(
    means2d: Tensor,
    conics: Tensor,
    colors: Tensor,
    opacities: Tensor,
    depths: Tensor,
    radii: Tensor,
    held: Frozen,
) -> tuple[Tensor, Tensor, Tensor]:
    """As `splat.rasterize_among`: the tiles that any splat touches, with the frozen splats that touch one of them."""
    height, width = held.alpha.shape
    tiles = touched_tiles(tile_spans(means2d, radii, width, height), width, height)
    near = touching(held.spans, tiles)
    moving = means2d, conics, colors, opacities, depths, radii
    m, c, k, o, d, r = (torch.cat([some, all_[near]]) for some, all_ in zip(moving, held.splats, strict=True))
    image, alpha = rasterize(m, c, k, o, d, r, width, height, tiles)
    drawn = tiles.repeat_interleave(TILE, 0).repeat_interleave(TILE, 1)[:height, :width]
    return torch.where(drawn[..., None], image, held.image), torch.where(drawn, alpha, held.alpha), tiles


def among_or_all(splats: ProjectedSplats, held: Frozen, everything: bool) -> Tensor:
    """The image [H, W, 3] of splats among frozen ones, or of these alone, which are all there is (everything)."""
    height, width = held.alpha.shape
    return rasterize(*splats, width, height)[0] if everything else rasterize_among(*splats, held)[0]


def remove(held: Frozen, gone: Tensor) -> tuple[Tensor, Tensor, Frozen]:
    """As `freeze`, of all but the splats [K] int64: the others keep their rows, and these have no opacity."""
    means2d, conics, colors, opacities, depths, radii = held.splats
    height, width = held.alpha.shape
    return freeze(means2d, conics, colors, opacities.index_fill(0, gone, 0.0), depths, radii, width, height)


def tile_spans(means2d: Tensor, radii: Tensor, width: int, height: int) -> Tensor:
    """[N, 4]: first and last tile column, first and last tile row that each splat touches; last < first if none.

    From the square of the radius, which is what gsplat sorts into tiles by.
    """
    low = ((means2d.detach() - radii[:, None]) / TILE).floor().long()
    high = ((means2d.detach() + radii[:, None]) / TILE).floor().long()
    columns, rows = -(-width // TILE), -(-height // TILE)
    left, right = low[:, 0].clamp_min(0), high[:, 0].clamp_max(columns - 1)
    top, bottom = low[:, 1].clamp_min(0), high[:, 1].clamp_max(rows - 1)
    seen = (radii > 0) & (right >= left) & (bottom >= top)
    empty = torch.tensor([0, -1, 0, -1], device=means2d.device)
    return torch.where(seen[:, None], torch.stack([left, right, top, bottom], 1), empty)


def touched_tiles(spans: Tensor, width: int, height: int) -> Tensor:
    """[rows, columns] bool: the tiles that any splat of spans [N, 4] touches, by counting corners."""
    rows, columns = -(-height // TILE), -(-width // TILE)
    there = (spans[:, 1] >= spans[:, 0]).long()  # picked by weight: to drop the others would wait for the GPU
    left, right, top, bottom = (spans.long() * there[:, None]).unbind(1)
    corners = torch.zeros((rows + 1) * (columns + 1), dtype=torch.int64, device=spans.device)
    for y, x, sign in ((top, left, 1), (top, right + 1, -1), (bottom + 1, left, -1), (bottom + 1, right + 1, 1)):
        corners.index_add_(0, y * (columns + 1) + x, there, alpha=sign)
    return corners.view(rows + 1, columns + 1).cumsum(0).cumsum(1)[:rows, :columns] > 0


def touching(spans: Tensor, tiles: Tensor) -> Tensor:
    """[M] int64: which splats of spans [N, 4] touch any of the tiles [rows, columns] bool, by sums over rectangles."""
    area = functional.pad(tiles.long().cumsum(0).cumsum(1), (1, 0, 1, 0))
    left, right, top, bottom = spans.long().unbind(1)
    right, bottom = right.clamp_min(-1) + 1, bottom.clamp_min(-1) + 1
    inside = area[bottom, right] - area[top, right] - area[bottom, left] + area[top, left]
    return torch.nonzero((inside > 0) & (right > left))[:, 0]
