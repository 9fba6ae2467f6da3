"""Readable torch versions of the kernels with gradients, differentiated by autograd. They are dense, for small scenes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
import torch.nn.functional as functional
from torch import Tensor

from splatreel.kernels import harmonics
from splatreel.kernels.hashgrid import PRIME_Y, PRIME_Z, is_dense
from splatreel.kernels.photometric import SSIM_C1, SSIM_C2, WINDOW

Skin = tuple[Tensor, Tensor]
"""index [N, K] int64 and share [N, K]: the nodes that each point moves with, and their weights. Neither gets a gradient."""


class Projection(NamedTuple):
    """`splat.Projection` of tensors."""

    means2d: Tensor
    conics: Tensor
    depths: Tensor
    radii: Tensor


class Splats(NamedTuple):
    """`splat.Splats` of tensors."""

    means2d: Tensor
    conics: Tensor
    colors: Tensor
    opacities: Tensor
    depths: Tensor
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
    """Twin of `project.forward`."""
    pose, lens = (torch.as_tensor(m, dtype=means.dtype) for m in (viewmat, K))
    fx, fy, cx, cy = lens[0, 0], lens[1, 1], lens[0, 2], lens[1, 2]
    X, Y, Z = (means @ pose[:3, :3].T + pose[:3, 3]).unbind(-1)
    in_front = near <= Z
    Z = torch.where(in_front, Z, torch.ones_like(Z))

    margin_x, margin_y = 0.15 * width / fx, 0.15 * height / fy
    u = (X / Z).clamp(-cx / fx - margin_x, (width - cx) / fx + margin_x)
    v = (Y / Z).clamp(-cy / fy - margin_y, (height - cy) / fy + margin_y)
    zero = torch.zeros_like(Z)
    jacobian = torch.stack([fx / Z, zero, -fx / Z * u, zero, fy / Z, -fy / Z * v], -1).view(-1, 2, 3)
    rotated = jacobian @ pose[:3, :3] @ _rotation(quats) * scales[:, None]
    covariance = rotated @ rotated.mT + (0.1 if antialias else 0.3) * torch.eye(2, dtype=means.dtype)
    cxx, cxy, cyy = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    determinant = cxx * cyy - cxy * cxy
    conics = torch.stack([cyy, -cxy, cxx], -1) / determinant[:, None]
    means2d = torch.stack([fx * X / Z + cx, fy * Y / Z + cy], -1)

    extent = (3.33 * torch.stack([cxx, cyy], -1).sqrt()).ceil()
    size = torch.tensor([width, height])
    inside = ((means2d + extent > 0) & (means2d - extent < size)).all(-1)
    seen = in_front & inside & (determinant > 0)
    radii = torch.where(seen, extent.amax(-1), zero).int()
    return Projection(means2d * seen[:, None], conics * seen[:, None], Z * seen, radii)


def _rotation(quats: Tensor) -> Tensor:
    w, x, y, z = functional.normalize(quats, dim=-1).unbind(-1)
    rows = [
        torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
        torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
        torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1),
    ]
    return torch.stack(rows, -2)


def spherical_harmonics(degree: int, directions: Tensor, coefficients: Tensor) -> Tensor:
    """Twin of `harmonics.forward`."""
    x, y, z = functional.normalize(directions, dim=-1).unbind(-1)
    xx, yy, zz = x * x, y * y, z * z
    polynomials = [torch.ones_like(x), -y, z, -x, x * y, y * z, 2 * zz - xx - yy, x * z, xx - yy]
    polynomials += [y * (3 * xx - yy), x * y * z, y * (4 * zz - xx - yy), z * (2 * zz - 3 * xx - 3 * yy)]
    polynomials += [x * (4 * zz - xx - yy), z * (xx - yy), x * (xx - 3 * yy)]
    factors = [harmonics.C0, *[harmonics.C1] * 3, *harmonics.C2, *harmonics.C3]
    bands = (degree + 1) ** 2
    basis = torch.stack([float(f) * p for f, p in zip(factors, polynomials, strict=True)][:bands], -1)
    return (basis[..., None] * coefficients[:, :bands]).sum(1)


def view_colors(means: Tensor, center: Tensor, base: Tensor, rest: Tensor) -> Tensor:
    """Twin of `harmonics.colors`."""
    degree = round((1 + rest.shape[1]) ** 0.5) - 1
    return (spherical_harmonics(degree, means.detach() - center, torch.cat([base, rest], 1)) + 0.5).clamp_min(0)


def deformed(
    points: Sequence[Tensor],
    offsets: tuple[Tensor, Tensor] | None,
    shade: Tensor | None,
    pinhole: tuple[Any, Any, int, int],
    center: Tensor,
    near: float,
    antialias: bool = False,
) -> Splats:
    """Twin of `deform.forward`."""
    means, quats, log_scales, logits, base, rest = points
    if shade is not None:
        base, logits = base + shade[:, None, :3], logits + shade[:, 3]
    if offsets is not None:
        means, quats = means + offsets[0], turn(quats, offsets[1])
    opacities = logits.sigmoid()
    means2d, conics, depths, radii = project(means, quats, log_scales.exp(), *pinhole, near, antialias)
    if antialias:
        xx, xy, yy = conics.unbind(1)
        opacities = opacities * (1 - 0.1 * (xx + yy) + 0.01 * (xx * yy - xy * xy)).clamp_min(1e-6).sqrt()
    return Splats(means2d, conics, view_colors(means, center, base, rest), opacities, depths.detach(), radii)


def rasterize(splats: Splats, width: int, height: int) -> tuple[Tensor, Tensor]:
    """Twin of `splat.rasterize`. Every pixel blends every Gaussian, in arrays [H * W, N]."""
    means2d, conics, colors, opacities, depths, radii = splats
    order = torch.argsort(depths.detach(), stable=True)
    order = order[radii[order] > 0]
    ys, xs = torch.meshgrid(
        torch.arange(height, dtype=means2d.dtype) + 0.5,
        torch.arange(width, dtype=means2d.dtype) + 0.5,
        indexing="ij",
    )
    dx, dy = xs.reshape(-1, 1) - means2d[order, 0], ys.reshape(-1, 1) - means2d[order, 1]
    a, b, c = conics[order].unbind(-1)
    sigma = 0.5 * (a * dx * dx + c * dy * dy) + b * dx * dy
    alpha = (opacities[order] * torch.exp(-sigma)).clamp_max(0.999)
    alpha = torch.where(alpha >= 1 / 255, alpha, torch.zeros_like(alpha))
    drawn = torch.cumprod(1 - alpha.detach(), 1) > 1e-4  # transmittance only falls: once false, false for all behind
    alpha = alpha * drawn
    transmittance = torch.cumprod(torch.cat([torch.ones_like(dx[:, :1].sum(1, keepdim=True)), 1 - alpha], 1), 1)
    image = (alpha * transmittance[:, :-1]) @ colors[order]
    return image.view(height, width, -1), (1 - transmittance[:, -1]).view(height, width)


def photometric_loss(image: Tensor, target: Tensor, lambda_dssim: float = 0.2, gain: Tensor | None = None) -> Tensor:
    """Twin of `photometric.loss_and_gradient`."""
    if target.dtype == torch.uint8:
        target = target.to(image.dtype) / 255
    if gain is not None:
        image = image * gain
    x, y = image.permute(2, 0, 1), target.permute(2, 0, 1)
    mx, my, xx, yy, xy = _blur(torch.stack([x, y, x * x, y * y, x * y]))
    vx, vy, covariance = xx - mx * mx, yy - my * my, xy - mx * my
    c1, c2 = float(SSIM_C1), float(SSIM_C2)
    ssim = (2 * mx * my + c1) * (2 * covariance + c2) / ((mx * mx + my * my + c1) * (vx + vy + c2))
    return (1 - lambda_dssim) * (image - target).abs().mean() + lambda_dssim * (1 - ssim.mean())


def _blur(maps: Tensor) -> Tensor:
    """Blur maps [M, 3, H, W] with the SSIM window, zeros outside."""
    flat = maps.reshape(-1, 1, *maps.shape[-2:])
    window = torch.as_tensor(WINDOW, dtype=maps.dtype)
    across = functional.conv2d(flat, window.view(1, 1, 1, -1), padding=(0, len(window) // 2))
    return functional.conv2d(across, window.view(1, 1, -1, 1), padding=(len(window) // 2, 0)).view(maps.shape)


def hashgrid(coords: Tensor, table: Tensor, resolutions: Tensor | np.ndarray) -> Tensor:
    """Twin of `hashgrid.forward`."""
    levels, size, features = table.shape
    cells = np.asarray(resolutions)
    dense = is_dense(cells, size)
    outputs = []
    for level in range(levels):
        resolution = torch.as_tensor(cells[level], dtype=torch.int64)
        position = coords.clamp(0, 1) * resolution
        cell = torch.minimum(position.detach().long(), resolution - 1)
        fraction = position - cell
        total = torch.zeros((len(coords), features), dtype=table.dtype)
        for corner in range(8):
            offset = torch.tensor([corner & 1, corner >> 1 & 1, corner >> 2])
            x, y, z = (cell + offset).unbind(-1)
            if dense[level]:
                row = x + (resolution[0] + 1) * (y + (resolution[1] + 1) * z)
            else:
                row = ((x ^ (y * int(PRIME_Y)) ^ (z * int(PRIME_Z))) & 0xFFFFFFFF) % size
            weight = torch.where(offset.bool(), fraction, 1 - fraction).prod(-1)
            total = total + weight[:, None] * table[level][row]
        outputs.append(total)
    return torch.cat(outputs, -1)


def spline(controls: Tensor, knot: int, weights: np.ndarray) -> Tensor:
    """Twin of `motion.spline`."""
    first, *others = weights.tolist()
    value = first * controls[knot]
    for k, weight in enumerate(others, 1):
        value = torch.add(value, controls[knot + k], alpha=weight)
    return value


def offsets(
    controls: tuple[Tensor, Tensor], knot: int, weights: np.ndarray, skin: Skin, unit: float
) -> tuple[Tensor, Tensor]:
    """Twin of `motion.offsets`."""
    nodes, points = (spline(level, knot, weights) for level in controls)
    index, share = skin
    total = points + (nodes[index] * share[..., None]).sum(1)
    return unit * total[:, :3], torch.cat([total[:, 3:4] + 1, total[:, 4:]], 1)


def turn(quats: Tensor, dq: Tensor) -> Tensor:
    """Return the Hamilton products quats * dq / |dq| of quaternions [N, 4], wxyz."""
    return multiply(quats, functional.normalize(dq, dim=-1))


def multiply(a: Tensor, b: Tensor) -> Tensor:
    """Return the Hamilton products of quaternions [N, 4], wxyz."""
    aw, av = a[:, :1], a[:, 1:]
    bw, bv = b[:, :1], b[:, 1:]
    w = aw * bw - (av * bv).sum(-1, keepdim=True)
    return torch.cat([w, aw * bv + bw * av + torch.linalg.cross(av, bv)], -1)


def arap(means: Tensor, dx: Tensor, dq: Tensor, neighbor: Tensor, weights: Tensor, unit: float) -> Tensor:
    """Twin of `motion.arap`."""
    half = (means - means[neighbor]).detach() / 2
    dq, rotation = functional.normalize(dq, dim=-1), _rotation(dq)
    rotated = ((rotation + rotation[neighbor]) @ half[..., None])[..., 0]
    apart = 2 * half + dx - dx[neighbor]
    # The translation left after the rotation (Delta r in the paper) is taken about the middle of the pair, which is better conditioned
    # than the world origin.
    shift = apart - rotated
    stretch = 2 * half.norm(dim=1) - apart.square().sum(1).add(1e-12).sqrt()
    turned = (dq - dq[neighbor]).abs().sum(1)
    return (weights * (turned + (shift.abs().sum(1) + stretch.abs()) / unit)).mean()
