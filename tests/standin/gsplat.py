"""gsplat with CPU kernels of this package in place of its CUDA kernels. Its Python code, shape checks and autograd stay.

Values that the CUDA kernels leave unset are NaN here: rows of culled points, and alpha in masked tiles.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.autograd import Function

from splatreel.kernels import binning, project, rasterize
from splatreel.kernels.project import Pinhole
from tests.kernels import twin
from tests.standin.device import Remote, held

TILE = 16


def install(patch: pytest.MonkeyPatch) -> None:
    """Make gsplat use these kernels. Skip the test if gsplat is not installed."""
    # gsplat's own backend would look for a compiler.
    patch.setitem(sys.modules, "gsplat.cuda._backend", ModuleType("gsplat.cuda._backend"))
    wrapper = pytest.importorskip("gsplat.cuda._wrapper", reason="gsplat is not installed")
    kernels = Kernels()
    patch.setattr(wrapper, "_make_lazy_cuda_func", lambda name: getattr(kernels, name))
    patch.setattr(wrapper, "_make_lazy_cuda_obj", lambda name: name)


class Kernels:
    """Replacements for the CUDA kernels, under the same names. Arguments without effect here have no names."""

    def __init__(self) -> None:
        self.near, self.radii = 0.0, torch.zeros(0, dtype=torch.int32)

    def projection_ewa_3dgs_fused_fwd(self, means, _, quats, scales, __, poses, lenses, *rest) -> tuple[Any, ...]:
        width, height, blur, self.near, *_ = rest
        points = _ready(means, quats, scales)
        with torch.no_grad():
            means2d, conics, depths, radii = self._project(points, poses, lenses, width, height, blur)
        culled = radii == 0
        for value in (means2d, conics, depths):
            value[culled] = torch.nan
        radii = torch.stack([radii, radii * 3 // 4], 1)
        return *(Remote(value[None]) for value in (radii, means2d, depths, conics)), None

    def projection_ewa_3dgs_fused_bwd(self, means, _, quats, scales, poses, lenses, *rest) -> tuple[Any, ...]:
        width, height, blur, _, radii, _, _, d_means2d, d_depths, d_conics, *_ = rest
        seen = held(radii)[0].amin(1) > 0
        leaves = [value.detach().clone().requires_grad_() for value in _ready(means, quats, scales)]
        with torch.enable_grad():
            means2d, conics, depths, _ = self._project(leaves, poses, lenses, width, height, blur)
            outputs = [means2d[seen], conics[seen], depths[seen]]
        gradients = [held(value)[0][seen] for value in (d_means2d, d_conics, d_depths)]
        a, b, c = torch.autograd.grad(outputs, leaves, gradients)
        return Remote(a), None, Remote(b), Remote(c), None

    def _project(self, points, poses, lenses, width: int, height: int, blur: float) -> tuple[Tensor, ...]:
        pose, lens = (value[0].numpy().copy() for value in _ready(poses, lenses))
        return Project.apply(*points, Pinhole(pose, lens, width, height, self.near, blur))  # pyright: ignore[reportReturnType]

    def spherical_harmonics_fwd(self, degree, directions, coefficients, _) -> Tensor:
        return Remote(twin.spherical_harmonics(degree, *_ready(directions, coefficients)))

    def spherical_harmonics_bwd(self, _, degree, directions, coefficients, __, d_colors, ___) -> tuple[Any, ...]:
        leaves = [value.detach().clone().requires_grad_() for value in _ready(directions, coefficients)]
        with torch.enable_grad():
            colors = twin.spherical_harmonics(degree, *leaves)
        ways, weights = torch.autograd.grad(colors, leaves, held(d_colors), allow_unused=True, materialize_grads=True)
        return Remote(weights), Remote(ways)

    def intersect_tile(self, means2d, radii, depths, *_) -> tuple[Tensor, Tensor, Tensor]:
        """Return one list for all tiles: the visible splats, near to far."""
        _, extents, depth = _ready(means2d, radii, depths)
        assert extents.dtype == torch.int32
        self.radii = extents[0].amax(1)
        order = torch.argsort(depth[0], stable=True)
        order = order[self.radii[order] > 0]
        return Remote((self.radii > 0).int()), Remote(order), Remote(order.int())

    def intersect_offset(self, _, images, columns, rows) -> Tensor:
        return Remote(torch.zeros(images, rows, columns, dtype=torch.int32))

    def rasterize_to_pixels_3dgs_fwd(self, means2d, conics, colors, opacities, _, masks, *rest) -> tuple[Tensor, ...]:
        width, height, _, _, order = rest
        splats = [value[0] for value in _ready(means2d, conics, colors, opacities)]
        with torch.no_grad():
            image, alpha = self._blend(splats, held(order), width, height)
        if masks is not None:
            drawn = _pixels(masks, width, height)
            image, alpha = image * drawn[..., None], torch.where(drawn, alpha, torch.nan)
        return Remote(image[None]), Remote(alpha[None, ..., None]), Remote(torch.zeros(1, height, width).int())

    def rasterize_to_pixels_3dgs_bwd(self, means2d, conics, colors, opacities, _, masks, *rest) -> tuple[Any, ...]:
        width, height, _, _, order, _, _, d_image, d_alpha, absgrad = rest
        leaves = [value[0].detach().clone().requires_grad_() for value in _ready(means2d, conics, colors, opacities)]
        absolute = torch.zeros_like(leaves[0]).requires_grad_()
        with torch.enable_grad():
            image, alpha = self._blend(leaves, held(order), width, height, absolute)
        drawn = torch.ones(height, width) if masks is None else _pixels(masks, width, height)
        d_image, d_alpha = held(d_image)[0] * drawn[..., None], held(d_alpha)[0, ..., 0] * drawn
        gradients = torch.autograd.grad([image, alpha], [absolute, *leaves], [d_image, d_alpha])
        found = [Remote(value[None]) for value in gradients]
        return found[0] if absgrad else None, *found[1:]

    def _blend(
        self, splats: list[Tensor], order: Tensor, width: int, height: int, absolute: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        means2d, conics, colors, opacities = splats
        radii, depths = torch.zeros(len(means2d), dtype=torch.int32), torch.zeros(len(means2d))
        order = order.long()
        radii[order], depths[order] = self.radii[order], torch.arange(1.0, len(order) + 1)
        splat = means2d, conics, colors, opacities, depths, radii
        return Rasterize.apply(*splat, width, height, absolute)  # pyright: ignore[reportReturnType]


class Project(Function):
    """The CPU's projection."""

    @staticmethod
    def forward(ctx: Any, means: Tensor, quats: Tensor, scales: Tensor, view: Pinhole) -> Any:
        found = project.forward(*_arrays(means, quats, scales), view=view)
        means2d, conics, depths, radii = map(torch.from_numpy, found)
        ctx.view = view
        ctx.save_for_backward(means, quats, scales, conics, radii)
        ctx.mark_non_differentiable(radii)
        return means2d, conics, depths, radii

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Any:
        means, quats, scales, conics, radii = ctx.saved_tensors
        arrays = _arrays(means, quats, scales, conics, *gradients[:3])
        return *map(torch.from_numpy, project.backward(*arrays, radii=radii.numpy(), view=ctx.view)), None


class Rasterize(Function):
    """The CPU's blending of three channels. The gradient of `absolute` is the sum of absolute gradients to means2d."""

    @staticmethod
    def forward(ctx: Any, means2d, conics, colors, opacities, depths, radii, width: int, height: int, absolute) -> Any:
        del absolute  # only its gradient counts
        centers, shapes, opaque, depth, shown = _arrays(means2d, conics, opacities, depths, colors)
        ctx.bins = binning.bin_splats(centers, shapes, opaque, depth, radii.numpy(), width, height)
        image, alpha = map(torch.from_numpy, rasterize.forward(ctx.bins, shown))
        ctx.save_for_backward(colors, image, alpha)
        return image, alpha

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Any:
        colors, image, alpha = _arrays(*ctx.saved_tensors)
        d_image, d_alpha = _arrays(*gradients)
        found = rasterize.backward(ctx.bins, colors, image, d_image, alpha, d_alpha)
        parts = found.means2d, found.conics, found.colors, found.opacities
        return *map(torch.from_numpy, parts), None, None, None, None, torch.from_numpy(found.absolute)


def _arrays(*tensors: Tensor) -> list[np.ndarray]:
    return [tensor.detach().contiguous().numpy() for tensor in tensors]


def _ready(*values: Tensor) -> list[Tensor]:
    """Return the wrapped tensors, after checking that they are on the simulated device and contiguous, as the kernels require."""
    for value in values:
        assert isinstance(value, Remote)
        assert value.is_contiguous()
    return [held(value) for value in values]


def _pixels(masks: Tensor, width: int, height: int) -> Tensor:
    """Return the pixels [H, W] bool of tiles [1, rows, columns]."""
    return held(masks)[0].repeat_interleave(TILE, 0).repeat_interleave(TILE, 1)[:height, :width]
