"""Projection and drawing by gsplat, frozen splats of which only the tiles that others touch are drawn again, and losses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import torch
import torch.nn.functional as functional
from torch import Tensor

import gsplat
from splatreel.kernels.photometric import SSIM_C1, SSIM_C2, WINDOW
from splatreel.kernels.project import BLUR, FINE_BLUR
from splatreel.method.train.terms.surfaces import EDGE_CONTRAST, MAX_SEPARATION, MIN_VARIANCE
from splatreel.method.train.terms.term import MIN_ALPHA

TILE = 16


@dataclass(frozen=True)
class Lens:
    """A view on the device.

    Attributes:
        antialias: Opacities are reduced by the area that antialiasing adds to splats.
        clear: Depth up to which static points are not drawn, world units.
        background: [3]; None is black.
        gain: [3], color gain with which the background is known; None is 1.
    """

    viewmat: Tensor
    K: Tensor
    center: Tensor
    width: int
    height: int
    antialias: bool
    clear: float
    background: Tensor | None
    gain: Tensor | None


class Splats(NamedTuple):
    """Projected points, see `kernels.splat.Splats`."""

    means2d: Tensor
    conics: Tensor
    colors: Tensor
    opacities: Tensor
    depths: Tensor
    radii: Tensor

    def rows(self, index: Tensor) -> Splats:
        """Return the rows of an index [M] int64."""
        return Splats(*[tensor.index_select(0, index) for tensor in self])

    @staticmethod
    def join(a: Splats, b: Splats) -> Splats:
        """Concatenate two sets of splats."""
        return Splats(*[torch.cat(pair) for pair in zip(a, b, strict=True)])


@dataclass(frozen=True)
class Frozen:
    """Splats that do not change, drawn once for one view.

    Attributes:
        splats: M splats.
        index: [M], row of each among all static points.
        spans: [M, 4], the tiles that each touches.
        image: [H, W, 3] over black.
        alpha: [H, W].
    """

    splats: Splats
    index: Tensor
    spans: Tensor
    image: Tensor
    alpha: Tensor


def splats_of(
    points: Sequence[Tensor], offsets: tuple[Tensor, Tensor] | None, shade: Tensor | None, lens: Lens, near: float
) -> Splats:
    """Deform points, project them and compute their colors relative to the background. Differentiable.

    `offsets` are dx [N, 3] and dq [N, 4]. `shade` [N, 4] is added to c_base and to the logit of the opacity.
    """
    means, quats, log_scales, logits, base, rest = points
    if shade is not None:
        base, logits = base + shade[:, None, :3], logits + shade[:, 3]
    if offsets is not None:
        means, quats = means + offsets[0], turn(quats, offsets[1])
    means2d, conics, depths, radii = _project(means, quats, log_scales.exp(), lens, near)
    opacities = logits.sigmoid()
    if lens.antialias:
        xx, xy, yy = conics.unbind(1)
        opacities = opacities * (1 - 0.1 * (xx + yy) + 0.01 * (xx * yy - xy * xy)).clamp_min(1e-6).sqrt()
    degree = round((1 + rest.shape[1]) ** 0.5) - 1
    ways = means.detach() - lens.center
    colors = (gsplat.spherical_harmonics(degree, ways, torch.cat([base, rest], 1)) + 0.5).clamp_min(0)
    if lens.background is not None:
        colors = colors - lens.background
    return Splats(means2d, conics, colors, opacities, depths.detach(), radii)


def _project(means: Tensor, quats: Tensor, scales: Tensor, lens: Lens, near: float) -> tuple[Tensor, ...]:
    """Return means2d, conics, depths and radii. Rows of culled points, which gsplat leaves unset, are set to zero."""
    camera = lens.viewmat[None], lens.K[None], lens.width, lens.height
    blur = FINE_BLUR if lens.antialias else BLUR
    radii, means2d, depths, conics, _ = gsplat.fully_fused_projection(
        means, None, quats, scales, *camera, eps2d=blur, near_plane=near
    )
    radii = radii[0].amax(-1).int()
    seen, zero = radii > 0, torch.zeros((), device=means.device)
    means2d = torch.where(seen[:, None], means2d[0], zero)
    conics = torch.where(seen[:, None], conics[0], zero)
    return means2d, conics, torch.where(seen, depths[0], zero), radii


def rasterize(
    splats: Splats, lens: Lens, absolute: Tensor | None = None, tiles: Tensor | None = None
) -> tuple[Tensor, Tensor]:
    """Return image and alpha over black, of splats with any number of channels.

    The backward pass adds the sums over pixels of the absolute gradients of `means2d` to `absolute` [N, 2]. gsplat
    leaves all tiles empty but those of `tiles` [rows, columns] bool.
    """
    means2d, conics, colors, opacities, depths, radii = splats
    width, height = lens.width, lens.height
    tiles_x, tiles_y = -(-width // TILE), -(-height // TILE)
    extents = radii[None, :, None].expand(-1, -1, 2).contiguous()
    _, pairs, ids = gsplat.isect_tiles(means2d.detach()[None], extents, depths.detach()[None], TILE, tiles_x, tiles_y)
    offsets = gsplat.isect_offset_encode(pairs, 1, tiles_x, tiles_y)
    masks = None if tiles is None else tiles[None].contiguous()
    centers = means2d[None]
    arguments: list[Any] = [centers, conics[None], colors[None], opacities[None], width, height, TILE, offsets, ids]
    image, alpha = gsplat.rasterize_to_pixels(*arguments, masks=masks, absgrad=absolute is not None)
    if absolute is not None and centers.requires_grad:  # the backward pass of gsplat sets the attribute `absgrad`

        def add(_: Tensor) -> None:
            absolute.add_(getattr(centers, "absgrad")[0])  # noqa: B009

        centers.register_hook(add)
    return image[0], alpha[0, ..., 0]


def freeze(splats: Splats, index: Tensor, lens: Lens) -> Frozen:
    """Draw splats that will not change. index: [M], row of each among all static points."""
    image, alpha = rasterize(splats, lens)
    return Frozen(splats, index, _tile_spans(splats, lens), image, alpha)


def rasterize_among(splats: Splats, frozen: Frozen, lens: Lens) -> tuple[Tensor, Tensor]:
    """Return image and alpha of splats together with frozen ones: the tiles that the splats touch are drawn, the others copied."""
    width, height = lens.width, lens.height
    tiles = _touched_tiles(_tile_spans(splats, lens), width, height)
    drawn_again = Splats.join(splats, frozen.splats.rows(_touching(frozen.spans, tiles)))
    image, alpha = rasterize(drawn_again, lens, tiles=tiles)
    drawn = tiles.repeat_interleave(TILE, 0).repeat_interleave(TILE, 1)[:height, :width]
    return torch.where(drawn[..., None], image, frozen.image), torch.where(drawn, alpha, frozen.alpha)


def _tile_spans(splats: Splats, lens: Lens) -> Tensor:
    """Return [N, 4]: the first and last tile column, and the first and last tile row, that each splat touches.

    As in gsplat, a splat touches a tile if the square of half side `radius` around its center does. If the splat touches no tile,
    last < first.
    """
    means2d, radii = splats.means2d.detach(), splats.radii
    low = ((means2d - radii[:, None]) / TILE).floor().long()
    high = ((means2d + radii[:, None]) / TILE).floor().long()
    columns, rows = -(-lens.width // TILE), -(-lens.height // TILE)
    left, right = low[:, 0].clamp_min(0), high[:, 0].clamp_max(columns - 1)
    top, bottom = low[:, 1].clamp_min(0), high[:, 1].clamp_max(rows - 1)
    seen = (radii > 0) & (right >= left) & (bottom >= top)
    left, top = (torch.where(seen, low, 0) for low in (left, top))
    right, bottom = (torch.where(seen, high, -1) for high in (right, bottom))
    return torch.stack([left, right, top, bottom], 1)


def _touched_tiles(spans: Tensor, width: int, height: int) -> Tensor:
    """Return [rows, columns] bool: the tiles that any splat of spans [N, 4] touches, by a 2D difference array."""
    rows, columns = -(-height // TILE), -(-width // TILE)
    there = (spans[:, 1] >= spans[:, 0]).long()  # a weight of 0 or 1, because dropping rows would wait for the GPU
    left, right, top, bottom = (spans * there[:, None]).unbind(1)
    corners = torch.zeros((rows + 1) * (columns + 1), dtype=torch.int64, device=spans.device)
    for y, x, sign in ((top, left, 1), (top, right + 1, -1), (bottom + 1, left, -1), (bottom + 1, right + 1, 1)):
        corners.index_add_(0, y * (columns + 1) + x, there, alpha=sign)
    return corners.view(rows + 1, columns + 1).cumsum(0).cumsum(1)[:rows, :columns] > 0


def _touching(spans: Tensor, tiles: Tensor) -> Tensor:
    """Return [M] int64: the splats of spans [N, 4] that touch any of the tiles [rows, columns] bool, by a summed-area table."""
    area = functional.pad(tiles.long().cumsum(0).cumsum(1), (1, 0, 1, 0))
    left, right, top, bottom = spans.unbind(1)
    right, bottom = right.clamp_min(-1) + 1, bottom.clamp_min(-1) + 1
    inside = area[bottom, right] - area[top, right] - area[bottom, left] + area[top, left]
    return torch.nonzero((inside > 0) & (right > left))[:, 0]


def turn(quats: Tensor, dq: Tensor) -> Tensor:
    """Return the Hamilton products quats * dq / |dq| of quaternions [N, 4], wxyz."""
    dq = functional.normalize(dq, dim=-1)
    aw, av = quats[:, :1], quats[:, 1:]
    bw, bv = dq[:, :1], dq[:, 1:]
    w = aw * bw - (av * bv).sum(-1, keepdim=True)
    return torch.cat([w, aw * bv + bw * av + torch.linalg.cross(av, bv)], -1)


def photometric(image: Tensor, target: Tensor, lambda_dssim: float, gain: Tensor | None) -> Tensor:
    """Return the photometric loss of 3DGS of an image [H, W, 3] against a target, uint8. gain: [3]; None is 1."""
    if gain is not None:
        image = image * gain
    x, y = image.permute(2, 0, 1), target.to(image.dtype).permute(2, 0, 1) / 255
    mx, my, xx, yy, xy = _blur(torch.stack([x, y, x * x, y * y, x * y]))
    vx, vy, covariance = xx - mx * mx, yy - my * my, xy - mx * my
    c1, c2 = float(SSIM_C1), float(SSIM_C2)
    ssim = (2 * mx * my + c1) * (2 * covariance + c2) / ((mx * mx + my * my + c1) * (vx + vy + c2))
    return (1 - lambda_dssim) * (x - y).abs().mean() + lambda_dssim * (1 - ssim.mean())


def _blur(maps: Tensor) -> Tensor:
    """Blur maps [M, 3, H, W] with the SSIM window, zeros outside."""
    flat, window = maps.reshape(-1, 1, *maps.shape[-2:]), _window(maps.device)
    across = functional.conv2d(flat, window.view(1, 1, 1, -1), padding=(0, len(window) // 2))
    return functional.conv2d(across, window.view(1, 1, -1, 1), padding=(len(window) // 2, 0)).view(maps.shape)


@cache
def _window(device: torch.device) -> Tensor:
    """Return the SSIM window [11], copied once, since a copy waits for the GPU."""
    return torch.as_tensor(WINDOW, dtype=torch.float32, device=device)


def surfaces(
    splats: Splats, lens: Lens, near: float, image: Tensor, spread: float, roughness: float, span: float
) -> Tensor:
    """Return the weighted losses of surfaces, see `method.train.terms.surfaces`. Only opacities get gradients.

    `span` is the typical viewing distance in multiples of the near plane.
    """
    depth = (splats.depths.clamp_min(near) / near).log()
    sums, alpha = rasterize(splats._replace(colors=torch.stack([depth, depth.square(), depth**3], 1)), lens)
    first, second, third = (sums / alpha.clamp_min(MIN_ALPHA)[..., None]).unbind(-1)
    cost = torch.zeros((), device=alpha.device)
    if spread:
        with torch.no_grad():
            variance = (second - first.square()).clamp_min(MIN_VARIANCE)
            skewness = (third - 3 * first * variance - first**3) / variance**1.5
            root = (skewness.square() + 4).sqrt()
            far = first + variance.sqrt() * (skewness + root) / 2
            share = (root - skewness) / (2 * root)
            weight = alpha * share.square() * (MAX_SEPARATION**2 / (variance * root.square())).clamp_max(1)
        cost = cost + spread * (weight * (second - 2 * far * first + far.square())).mean()
    if roughness:
        cost = cost + roughness * _bends(span * (-first).exp(), image.float() / 255)
    return cost


def _bends(inverse: Tensor, colors: Tensor) -> Tensor:
    """Return the mean second difference of inverse depths [H, W] along rows and columns, less where colors [H, W, 3] differ."""
    cost = inverse.new_zeros(())
    for along in (0, 1):
        before, here, after = (inverse.narrow(along, k, inverse.shape[along] - 2) for k in range(3))
        first, last = (colors.narrow(along, k, inverse.shape[along] - 2) for k in (0, 2))
        plain = torch.exp((last - first).abs().amax(-1) / -EDGE_CONTRAST)
        cost = cost + (plain * (before - 2 * here + after).abs()).mean()
    return cost


def rigidity(means: Tensor, dx: Tensor, dq: Tensor, neighbor: Tensor, weights: Tensor, unit: float) -> Tensor:
    """Return the as-rigid-as-possible loss of every point with one neighbor, see `kernels.motion.arap`."""
    half = (means - means[neighbor]).detach() / 2
    dq, rotation = functional.normalize(dq, dim=-1), _rotation(dq)
    rotated = ((rotation + rotation[neighbor]) @ half[..., None])[..., 0]
    apart = 2 * half + dx - dx[neighbor]
    shift = apart - rotated
    stretch = 2 * half.norm(dim=1) - apart.square().sum(1).add(1e-12).sqrt()
    turned = (dq - dq[neighbor]).abs().sum(1)
    return (weights * (turned + (shift.abs().sum(1) + stretch.abs()) / unit)).mean()


def _rotation(quats: Tensor) -> Tensor:
    w, x, y, z = functional.normalize(quats, dim=-1).unbind(-1)
    rows = [
        torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
        torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
        torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1),
    ]
    return torch.stack(rows, -2)
