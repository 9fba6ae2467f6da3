"""Offsets of moving points as splines in time, and their gradient: numba kernels on the CPU, torch on CUDA.

They are linear in their control values, of which a moment depends on four knots. So no graph is made of them: the offsets are leaves,
and what autograd finds for them is taken on to the controls in one pass.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from splatreel.kernels import twin
from splatreel.kernels.cpu import motion as kernel

Skin = tuple[Tensor, Tensor]
"""index [N, K] int64, share [N, K]: the nodes that a point moves with, and how much. Neither gets a gradient."""


def spline(controls: Tensor, knot: int, weights: np.ndarray) -> Tensor:
    """Splines in time at one moment, [R, D], without gradients: the moment's gradient is that of its four knots, by their weights.

    controls: [knots, R, D]. knot, weights: the first of the four knots that count, and their weights [4] float32.
    """
    if controls.is_cuda:
        return twin.spline(controls, knot, weights)
    return torch.from_numpy(kernel.spline(controls.numpy()[knot : knot + 4], weights))


def offsets(
    controls: tuple[Tensor, Tensor], knot: int, weights: np.ndarray, skin: Skin, unit: float
) -> tuple[Tensor, Tensor]:
    """dx [N, 3] and dq [N, 4] of points at one moment, without gradients: the sum of their nodes' splines and their own.

    controls: [knots, M, 7] of the nodes and [knots, N, 7] of the points: dx by `unit`, and dq less its identity. knot, weights: as
    `spline` takes them. See `offsets_gradient`.
    """
    if controls[1].is_cuda:
        return twin.offsets(controls, knot, weights, skin, unit)
    nodes, points = (level.numpy()[knot : knot + 4] for level in controls)
    dx, dq = kernel.offsets(nodes, points, weights, (skin[0].numpy(), skin[1].numpy()), unit)
    return torch.from_numpy(dx), torch.from_numpy(dq)


def offsets_gradient(d_dx: Tensor, d_dq: Tensor, skin: Skin, nodes: int, unit: float) -> tuple[Tensor, Tensor]:
    """Gradients [M, 7] and [N, 7] to the values that the splines of M nodes and N points have at a moment.

    d_dx: [N, 3], d_dq: [N, 4]: gradients to what `offsets` returned.
    """
    if d_dx.is_cuda:
        return twin.offsets_gradient(d_dx, d_dq, skin, nodes, unit)
    arrays = d_dx.contiguous().numpy(), d_dq.contiguous().numpy(), (skin[0].numpy(), skin[1].numpy())
    d_nodes, d_points = kernel.offsets_gradient(*arrays, nodes, unit)
    return torch.from_numpy(d_nodes), torch.from_numpy(d_points)
