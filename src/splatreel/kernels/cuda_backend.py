"""The CUDA backend: kernels from gsplat."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import torch.nn.functional as functional
from torch import Tensor

from splatreel.base.command_line import install_command
from splatreel.base.errors import MissingDependencyError
from splatreel.kernels.backend import Backend
from splatreel.kernels.cpu.project import BLUR, FINE_BLUR
from splatreel.kernels.projected import FrozenSplats, Projection, Splats

TILE = 16


def _gsplat():
    try:
        import gsplat
    except ImportError as error:
        raise MissingDependencyError(
            f"Tensors are on CUDA, but gsplat is not installed. Run `{install_command('cuda')}`, or use --device cpu."
        ) from error
    return gsplat


@dataclass(frozen=True)
class Held:
    """Splats that do not change. spans: [M, 4], the tiles that each splat touches, as `tile_spans` returns them."""

    splats: Splats
    spans: Tensor


class CudaBackend(Backend):
    """Kernels for CUDA tensors, from gsplat. Functions that gsplat lacks run as plain torch."""

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
        """Return projected Gaussians. Rows of culled Gaussians, which gsplat leaves unset, are set to zero."""
        pose = torch.as_tensor(viewmat, dtype=torch.float32, device=means.device)[None]
        lens = torch.as_tensor(K, dtype=torch.float32, device=means.device)[None]
        blur = FINE_BLUR if antialias else BLUR
        radii, means2d, depths, conics, _ = _gsplat().fully_fused_projection(
            means, None, quats, scales, pose, lens, width, height, eps2d=blur, near_plane=near
        )
        radii = radii[0].amax(-1).int()
        seen = radii > 0
        zero = torch.zeros((), device=means.device)
        means2d = torch.where(seen[:, None], means2d[0], zero)
        conics = torch.where(seen[:, None], conics[0], zero)
        return Projection(means2d, conics, torch.where(seen, depths[0], zero), radii)

    def spherical_harmonics(self, degree: int, directions: Tensor, coefficients: Tensor) -> Tensor:
        return _gsplat().spherical_harmonics(degree, directions, coefficients)

    def rasterize(
        self, splats: Splats, width: int, height: int, absolute: Tensor | None = None, tiles: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Return image and alpha. tiles: [rows, columns] bool, the tiles to draw; gsplat leaves all other tiles empty."""
        means2d, conics, colors, opacities, depths, radii = splats
        gsplat = _gsplat()
        tiles_x, tiles_y = -(-width // TILE), -(-height // TILE)
        extents = radii[None, :, None].expand(-1, -1, 2).contiguous()
        _, pairs, ids = gsplat.isect_tiles(
            means2d.detach()[None], extents, depths.detach()[None], TILE, tiles_x, tiles_y
        )
        offsets = gsplat.isect_offset_encode(pairs, 1, tiles_x, tiles_y)
        masks = None if tiles is None else tiles[None].contiguous()
        centers = means2d[None]
        arguments: list[Any] = [centers, conics[None], colors[None], opacities[None], width, height, TILE, offsets, ids]
        image, alpha = gsplat.rasterize_to_pixels(*arguments, masks=masks, absgrad=absolute is not None)
        if absolute is not None and centers.requires_grad:  # the backward pass of gsplat sets the attribute `absgrad`
            centers.register_hook(lambda _: _accumulate(absolute, getattr(centers, "absgrad")[0]))  # noqa: B009
        return image[0], alpha[0, ..., 0]

    def freeze(self, splats: Splats, width: int, height: int) -> FrozenSplats:
        kept = Splats(*[tensor.detach() for tensor in splats])
        image, alpha = self.rasterize(kept, width, height)
        return FrozenSplats(image, alpha, Held(kept, tile_spans(kept.means2d, kept.radii, width, height)))

    def remove(self, frozen: FrozenSplats, gone: Tensor) -> FrozenSplats:
        """Return frozen splats with the same rows. The removed splats have an opacity of 0."""
        splats: Splats = frozen.held.splats
        height, width = frozen.alpha.shape
        return self.freeze(splats._replace(opacities=splats.opacities.index_fill(0, gone, 0.0)), width, height)

    def rasterize_among(self, splats: Splats, frozen: FrozenSplats) -> tuple[Tensor, Tensor, Tensor]:
        """Draw the tiles that the given splats touch, together with the frozen splats that touch these tiles."""
        height, width = frozen.alpha.shape
        tiles = touched_tiles(tile_spans(splats.means2d, splats.radii, width, height), width, height)
        drawn_again = Splats.join(splats, frozen.held.splats.rows(touching(frozen.held.spans, tiles)))
        image, alpha = self.rasterize(drawn_again, width, height, tiles=tiles)
        drawn = tiles.repeat_interleave(TILE, 0).repeat_interleave(TILE, 1)[:height, :width]
        return torch.where(drawn[..., None], image, frozen.image), torch.where(drawn, alpha, frozen.alpha), tiles


def _accumulate(tensor: Tensor, gradient: Tensor) -> None:
    """Add to the gradient of a leaf tensor."""
    tensor.grad = gradient if tensor.grad is None else tensor.grad + gradient


def tile_spans(means2d: Tensor, radii: Tensor, width: int, height: int) -> Tensor:
    """Return [N, 4]: the first and last tile column, and the first and last tile row, that each splat touches.

    As in gsplat, a splat touches a tile if the square of half side `radius` around its center does. If the splat touches no tile,
    last < first.
    """
    low = ((means2d.detach() - radii[:, None]) / TILE).floor().long()
    high = ((means2d.detach() + radii[:, None]) / TILE).floor().long()
    columns, rows = -(-width // TILE), -(-height // TILE)
    left, right = low[:, 0].clamp_min(0), high[:, 0].clamp_max(columns - 1)
    top, bottom = low[:, 1].clamp_min(0), high[:, 1].clamp_max(rows - 1)
    seen = (radii > 0) & (right >= left) & (bottom >= top)
    left, top = (torch.where(seen, low, 0) for low in (left, top))
    right, bottom = (torch.where(seen, high, -1) for high in (right, bottom))
    return torch.stack([left, right, top, bottom], 1)


def touched_tiles(spans: Tensor, width: int, height: int) -> Tensor:
    """Return [rows, columns] bool: the tiles that any splat of spans [N, 4] touches, by a 2D difference array."""
    rows, columns = -(-height // TILE), -(-width // TILE)
    there = (spans[:, 1] >= spans[:, 0]).long()  # a weight of 0 or 1, because dropping rows would wait for the GPU
    left, right, top, bottom = (spans.long() * there[:, None]).unbind(1)
    corners = torch.zeros((rows + 1) * (columns + 1), dtype=torch.int64, device=spans.device)
    for y, x, sign in ((top, left, 1), (top, right + 1, -1), (bottom + 1, left, -1), (bottom + 1, right + 1, 1)):
        corners.index_add_(0, y * (columns + 1) + x, there, alpha=sign)
    return corners.view(rows + 1, columns + 1).cumsum(0).cumsum(1)[:rows, :columns] > 0


def touching(spans: Tensor, tiles: Tensor) -> Tensor:
    """Return [M] int64: the splats of spans [N, 4] that touch any of the tiles [rows, columns] bool, by a summed-area table."""
    area = functional.pad(tiles.long().cumsum(0).cumsum(1), (1, 0, 1, 0))
    left, right, top, bottom = spans.long().unbind(1)
    right, bottom = right.clamp_min(-1) + 1, bottom.clamp_min(-1) + 1
    inside = area[bottom, right] - area[top, right] - area[bottom, left] + area[top, left]
    return torch.nonzero((inside > 0) & (right > left))[:, 0]
