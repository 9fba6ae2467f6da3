"""Differentiable Gaussian splatting on torch tensors: the face of most fast kernels. `motion` and `adam` are its others on tensors.

The device of the tensors picks the implementation: numba kernels with hand-written gradients on the CPU, gsplat on CUDA.
Both follow gsplat's rules: 0.3 px^2 added to the 2D covariance diagonal, alpha = min(0.999, opacity exp(-sigma)), alphas
below 1/255 skipped, a pixel full once its transmittance would fall to 1e-4, pixel centers at +0.5. `twin` holds a
readable torch version of every function here, with the same signature, as the oracle of the tests.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from scipy.spatial import KDTree
from torch import Tensor

from splatreel import threads
from splatreel.errors import GaussiansError
from splatreel.kernels import cuda, twin
from splatreel.kernels.cpu import autograd as cpu
from splatreel.kernels.cpu.project import BLUR, FINE_BLUR, Pinhole, kept_area


class Projection(NamedTuple):
    """means2d: [N, 2] pixels. conics: [N, 3], xx, xy, yy of the inverse 2D covariance. depths: [N] along the camera's z.

    radii: [N] int32, the longer half side of the box where alpha may reach 1/255, pixels; 0 for culled Gaussians.
    """

    means2d: Tensor
    conics: Tensor
    depths: Tensor
    radii: Tensor


class Rendered(NamedTuple):
    """image: [H, W, 3] over black. alpha: [H, W]. means2d: [N, 2] pixels, in the graph. radii: [N] int32, 0: culled."""

    image: Tensor
    alpha: Tensor
    means2d: Tensor
    radii: Tensor


class FrozenSplats(NamedTuple):
    """Splats that never change, as one view sees them, drawn once: `freeze` makes it, `rasterize_among` draws in between.

    image: [H, W, 3] and alpha: [H, W], their picture. held: what the device needs to draw others among them.
    """

    image: Tensor
    alpha: Tensor
    held: Any


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
    """Projects Gaussians to the image; rows of culled ones are zero.

    means: [N, 3] world. quats: [N, 4] wxyz, normalized inside, with the gradient through it. scales: [N, 3].
    viewmat: [4, 4] world to camera, K: [3, 3] pixels; neither gets a gradient. near: least depth drawn, scene units.
    antialias: blurred by 0.1 square pixels in place of 0.3, for opacities that are `antialiased`.
    Raises `GaussiansError` for NaN or infinity.
    """
    _check_finite(means=means, quats=quats, scales=scales)
    blur = FINE_BLUR if antialias else BLUR
    if means.is_cuda:
        return Projection(*cuda.project(means, quats, scales, viewmat, K, width, height, near, blur))
    view = Pinhole(_matrix(viewmat), _matrix(K), width, height, near, blur)
    return Projection(*cpu.Project.apply(means, quats, scales, view))  # pyright: ignore[reportGeneralTypeIssues]


def spherical_harmonics(degree: int, directions: Tensor, coefficients: Tensor) -> Tensor:
    """Sum of the harmonics up to degree 0..3 in the 3DGS order, without the 0.5 of 3DGS colors.

    directions: [N, 3], from the camera to the point, any length. coefficients: [N, K, 3], K >= (degree + 1)^2.
    Returns [N, 3]. Raises `GaussiansError` for a degree the coefficients do not hold.
    """
    if not 0 <= degree <= 3 or coefficients.shape[1] < (degree + 1) ** 2:
        raise GaussiansError(
            f"SH degree {degree} needs {(degree + 1) ** 2} coefficients, there are {coefficients.shape[1]}; choose 0..3."
        )
    if coefficients.is_cuda:
        return cuda.spherical_harmonics(degree, directions, coefficients)
    return cpu.SphericalHarmonics.apply(degree, directions, coefficients)  # pyright: ignore[reportReturnType]


def view_colors(means: Tensor, center: Tensor, base: Tensor, rest: Tensor) -> Tensor:
    """Colors [N, 3] of points seen from center [3]: 0.5 and the harmonics, at least 0.

    means: [N, 3]. base: [N, 1, 3] and rest: [N, K - 1, 3], K 1, 4, 9 or 16, in the 3DGS order; only they get gradients.
    """
    if means.is_cuda:
        degree = round((1 + rest.shape[1]) ** 0.5) - 1
        return (spherical_harmonics(degree, means.detach() - center, torch.cat([base, rest], 1)) + 0.5).clamp_min(0)
    return cpu.ViewColors.apply(means.detach(), center, base, rest)  # pyright: ignore[reportReturnType]


def antialiased(opacities: Tensor, conics: Tensor) -> Tensor:
    """Opacities [N] of splats that are drawn blurred, for conics [N, 3] of `project`: less, as their area is more.

    Without it a splat thinner than a pixel covers as much as one of a pixel, and pictures of another size than those it was trained
    on are too thick or too thin. sqrt(det C / det(C + 0.1)), as Mip-Splatting (section 4.2); gsplat's `antialiased` has 0.3.
    """
    return opacities * kept_area(*conics.unbind(1)).clamp_min(1e-6).sqrt()


def deformed(
    points: Sequence[Tensor],
    offsets: tuple[Tensor, Tensor] | None,
    shade: Tensor | None,
    pinhole: tuple[Tensor, Tensor, int, int],
    center: Tensor,
    near: float,
    antialias: bool = False,
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Points of one moment as a view sees them: means2d, conics, colors, opacities, depths and radii, as `rasterize` takes them.

    points: means, quats, log_scales, logit_opacities [N], sh_base [N, 1, 3] and sh_rest [N, K - 1, 3]. offsets: dx [N, 3] and
    dq [N, 4], which need not be unit (paper section 4.2: x + dx, q * dq), or None. shade: [N, 4], what c_base and the opacity's logit
    gain, or None. pinhole: as `project` takes it; center: [3], the camera's. Gradients go to points, offsets and shade. Raises
    `GaussiansError` for NaN or infinity.
    """
    means, quats, log_scales, *_ = points
    moved = {} if offsets is None else {"dx": offsets[0], "dq": offsets[1]}
    _check_finite(means=means, quats=quats, log_scales=log_scales, **moved)
    if means.is_cuda:
        return _deformed(points, offsets, shade, pinhole, center, near, antialias)
    viewmat, K, width, height = pinhole
    view = Pinhole(_matrix(viewmat), _matrix(K), width, height, near, FINE_BLUR if antialias else BLUR)
    return cpu.Deformed.apply(view, center, *(offsets or (None, None)), shade, *points)  # pyright: ignore[reportReturnType]


def _deformed(
    points: Sequence[Tensor],
    offsets: tuple[Tensor, Tensor] | None,
    shade: Tensor | None,
    pinhole: tuple[Tensor, Tensor, int, int],
    center: Tensor,
    near: float,
    antialias: bool,
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]:
    means, quats, log_scales, logits, base, rest = points
    if shade is not None:
        base, logits = base + shade[:, None, :3], logits + shade[:, 3]
    if offsets is not None:
        means, quats = means + offsets[0], twin.turn(quats, offsets[1])
    opacities = logits.sigmoid()
    means2d, conics, depths, radii = project(means, quats, log_scales.exp(), *pinhole, near, antialias)
    colors = view_colors(means, center, base, rest)
    return means2d, conics, colors, antialiased(opacities, conics) if antialias else opacities, depths, radii


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
    """Blends projected Gaussians front to back over black.

    colors: [N, C], any C; opacities: [N] in 0..1; the others as `project` returns them. Returns the image [H, W, C] and
    alpha [H, W]. Gradients go to means2d, conics, colors and opacities. Raises `GaussiansError` for NaN or infinity.
    """
    _check_finite(means2d=means2d, conics=conics, colors=colors, opacities=opacities)
    arguments = (means2d, conics, colors, opacities, depths, radii, width, height)
    if means2d.is_cuda:
        return cuda.rasterize(*arguments)
    return cpu.Rasterize.apply(*arguments)  # pyright: ignore[reportReturnType]


def freeze(
    means2d: Tensor,
    conics: Tensor,
    colors: Tensor,
    opacities: Tensor,
    depths: Tensor,
    radii: Tensor,
    width: int,
    height: int,
) -> FrozenSplats:
    """Sorts splats that will not change into tiles and draws them. colors: [M, 3]; the others as `rasterize` takes them."""
    _check_finite(means2d=means2d, conics=conics, colors=colors, opacities=opacities)
    arguments = (means2d, conics, colors, opacities, depths, radii, width, height)
    if means2d.is_cuda:
        return FrozenSplats(*cuda.freeze(*arguments))
    held = cpu.freeze(*arguments)
    return FrozenSplats(torch.from_numpy(held.image), torch.from_numpy(held.alpha), held)


def remove(frozen: FrozenSplats, gone: Tensor) -> FrozenSplats:
    """The same without some splats; on the CPU the same object, drawn anew where those were.

    gone: [K] int64, rows of what `freeze` was given, also if others have gone before.
    """
    if frozen.image.is_cuda:
        return FrozenSplats(*cuda.remove(frozen.held, gone))
    cpu.remove(frozen.held, gone)
    return frozen


def rasterize_among(
    means2d: Tensor,
    conics: Tensor,
    colors: Tensor,
    opacities: Tensor,
    depths: Tensor,
    radii: Tensor,
    frozen: FrozenSplats,
) -> tuple[Tensor, Tensor, Tensor]:
    """Blends projected Gaussians in front of, between and behind frozen ones; only where they are is anything drawn anew.

    colors: [N, 3]; the others as `rasterize` takes them. Returns the image [H, W, 3], alpha [H, W] and tiles, [ceil(H / 16),
    ceil(W / 16)] bool: outside of these the picture is that of the frozen ones. Same picture, and same gradients to means2d, conics,
    colors and opacities, as of all splats together. Raises `GaussiansError` for NaN or infinity.
    """
    _check_finite(means2d=means2d, conics=conics, colors=colors, opacities=opacities)
    arguments = (means2d, conics, colors, opacities, depths, radii, frozen.held)
    if means2d.is_cuda:
        return cuda.rasterize_among(*arguments)
    return cpu.RasterizeAmong.apply(*arguments)  # pyright: ignore[reportReturnType]


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
    """The image of Gaussians with SH colors [N, K, 3]; degree defaults to all K holds. antialias: see `antialiased`.

    Call `means2d.retain_grad()` on the result before backward to get screen-space gradients, in loss per pixel.
    """
    bands = round(sh.shape[1] ** 0.5) - 1 if degree is None else degree
    projection = project(means, quats, scales, viewmat, K, width, height, near, antialias)
    pose = torch.as_tensor(viewmat, dtype=torch.float32, device=means.device)
    center = -pose[:3, :3].T @ pose[:3, 3]
    colors = (spherical_harmonics(bands, means - center, sh) + 0.5).clamp_min(0)
    means2d, conics, depths, radii = projection
    if antialias:
        opacities = antialiased(opacities, conics)
    image, alpha = rasterize(means2d, conics, colors, opacities, depths, radii, width, height)
    return Rendered(image, alpha, means2d, radii)


def photometric_loss(
    image: Tensor, target: Tensor, lambda_dssim: float = 0.2, gain: Tensor | None = None, tiles: Tensor | None = None
) -> Tensor:
    """(1 - lambda) mean|image * gain - target| + lambda (1 - mean SSIM), as 3DGS.

    SSIM has an 11 x 11 Gaussian window of sigma 1.5 and zero padding.
    image: [H, W, 3] 0..1. target: [H, W, 3], float 0..1 or uint8; it gets no gradient. gain: [3], of the channels.
    tiles: [ceil(H / 16), ceil(W / 16)] bool, the only ones that change, as `rasterize_among` returns them. The loss may then be off by
    what depends on no pixel of theirs, a constant, and pixels outside of them get no gradient, nor may the gain ask for one.
    """
    if image.shape != target.shape or image.shape[-1] != 3:
        shapes = f"image {tuple(image.shape)}, target {tuple(target.shape)}"
        raise GaussiansError(f"photometric_loss: {shapes}; both must be [H, W, 3].")
    if tiles is not None and gain is not None and gain.requires_grad:
        raise GaussiansError(
            "photometric_loss: the gradient of a gain needs all tiles; pass no tiles, or gain.detach()."
        )
    if image.is_cuda:
        return twin.photometric_loss(image, target, lambda_dssim, gain, tiles)
    return cpu.PhotometricLoss.apply(image, target, lambda_dssim, gain, tiles)  # pyright: ignore[reportReturnType]


def layered_loss(
    means2d: Tensor,
    conics: Tensor,
    colors: Tensor,
    opacities: Tensor,
    depths: Tensor,
    radii: Tensor,
    frozen: FrozenSplats,
    target: Tensor,
    lambda_dssim: float = 0.2,
    gain: Tensor | None = None,
    background: Tensor | None = None,
    where: Tensor | None = None,
) -> Tensor:
    """`photometric_loss` of the picture of `rasterize_among`, in the tiles that it draws anew, and a constant.

    background: [3], added to the picture before the gain [3]; neither gets a gradient. where: [N] bool; the splats are then all that
    is to be seen, frozen ones too, which get gradients like the others, in the tiles that one of those touches; what moves must be
    among those. Much faster than the two functions where little of a large picture is drawn anew. Not by two threads at once among
    the same frozen splats. Raises `GaussiansError` for NaN or infinity.
    """
    _check_finite(means2d=means2d, conics=conics, colors=colors, opacities=opacities)
    splats = means2d, conics, colors, opacities, depths, radii
    if means2d.is_cuda:
        image = cuda.among_or_all(splats, frozen.held, everything=where is not None)
        return twin.photometric_loss(image if background is None else image + background, target, lambda_dssim, gain)
    return cpu.LayeredLoss.apply(*splats, frozen.held, target, lambda_dssim, gain, background, where)  # pyright: ignore[reportReturnType]


def nearest_neighbors(points: Tensor, k: int, queries: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """The k nearest points of each query: indices [Q, k] int64 and distances [Q, k], nearest first.

    points: [N, 3]. queries: [Q, 3]; None asks for the neighbors of the points themselves, each excluding itself.
    """
    available = len(points) - (queries is None)
    if not 1 <= k <= available:
        raise GaussiansError(f"nearest_neighbors: asked for {k} neighbors where there are {available}.")
    if points.is_cuda:
        return twin.nearest_neighbors(points, k, queries)
    asked = points if queries is None else queries
    ranks: Any = np.arange(1, k + 1 + (queries is None))  # a list, so that one neighbor still gives a column
    found = KDTree(points.detach().numpy()).query(asked.detach().numpy(), k=ranks, workers=threads.count())
    distances, indices = np.asarray(found[0], np.float32), np.asarray(found[1], np.int64)
    if queries is None:
        indices, distances = _without_self(indices, distances)
    return torch.from_numpy(indices), torch.from_numpy(distances)


def hashgrid(coords: Tensor, table: Tensor, resolutions: Tensor | np.ndarray) -> Tensor:
    """Multiresolution hash grid (Instant-NGP): trilinear features of every level, [N, L * F].

    coords: [N, 3], clamped to 0..1. table: [L, T, F], T a power of two. resolutions: [L, 3] ints, cells an axis; a level
    whose corners fit into T rows is stored densely, others are hashed. Gradients go to table and coords.
    Raises `GaussiansError` for shapes that do not fit.
    """
    cells = np.ascontiguousarray(resolutions.cpu().numpy() if isinstance(resolutions, Tensor) else resolutions)
    size = table.shape[1]
    if cells.shape != (len(table), 3) or cells.min() < 1 or size & (size - 1):
        raise GaussiansError(
            f"hashgrid: table {tuple(table.shape)} and resolutions {cells.shape}, least {cells.min()}, do not fit; "
            "they must be [L, T, F], T a power of two, and [L, 3], at least 1."
        )
    if coords.is_cuda:
        return twin.hashgrid(coords, table, cells)
    return cpu.HashGrid.apply(coords, table, cells)  # pyright: ignore[reportReturnType]


def arap(means: Tensor, dx: Tensor, dq: Tensor, neighbor: Tensor, weights: Tensor, unit: float) -> Tensor:
    """As rigid as possible (paper section 4.2): neighbors rotate alike, translate alike and keep their distance.

    means, dx: [N, 3]; dq: [N, 4]; neighbor: [N] int64, a neighbor of every point; weights: [N]. Lengths are measured in `unit`.
    Only dx and dq get gradients. Mean over the points.
    """
    if means.is_cuda:
        return twin.arap(means, dx, dq, neighbor, weights, unit)
    return cpu.Arap.apply(means, dx, dq, neighbor, weights, unit)  # pyright: ignore[reportReturnType]


def _matrix(value: Tensor | np.ndarray) -> np.ndarray:
    if isinstance(value, Tensor):
        value = value.detach().cpu().numpy()
    return np.ascontiguousarray(value, np.float32)


def _without_self(indices: np.ndarray, distances: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Drops each point from its own neighbors; among coinciding points it need not be the first."""
    own = indices == np.arange(len(indices))[:, None]
    own[~own.any(1), -1] = True  # crowded out by coinciding points: drop the last instead
    shape = (len(indices), indices.shape[1] - 1)
    return indices[~own].reshape(shape), distances[~own].reshape(shape)


def _check_finite(**tensors: Tensor) -> None:
    """Raises `GaussiansError`. What a GPU trains on is not looked at, as that would wait for it; who trains calls `check_finite`."""
    if not torch.is_grad_enabled() or not any(tensor.is_cuda and tensor.requires_grad for tensor in tensors.values()):
        check_finite(**tensors)


def check_finite(**tensors: Tensor) -> None:
    """Raises `GaussiansError` with the name of the tensor that holds NaN or infinity."""
    for name, tensor in tensors.items():
        values = tensor.detach()
        # The sum is quick, but may overflow.
        if not math.isfinite(values.sum().item()) and not torch.isfinite(values).all():
            bad = int((~torch.isfinite(values)).sum())
            raise GaussiansError(
                f"Gaussians: {name} holds {bad} values that are NaN or infinite; lower the learning rate."
            )
