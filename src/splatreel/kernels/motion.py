"""Motion of points: offsets as splines in time and their gradients, hash grid features, and the rigidity loss.

Offsets are linear in their control values, and one time depends on four knots. So autograd gets no graph of them: the offsets are leaf
tensors, and `offsets_gradient` carries their gradients to the controls in one pass.
"""

from __future__ import annotations

import numpy as np
from torch import Tensor

from splatreel.base.errors import GaussiansError
from splatreel.kernels.backends import backend_of
from splatreel.kernels.twin import Skin

__all__ = ["Skin", "arap", "hashgrid", "offsets", "offsets_gradient", "spline"]


def spline(controls: Tensor, knot: int, weights: np.ndarray) -> Tensor:
    """Return the values [R, D] of cubic splines at one time, without gradients.

    Args:
        controls: [knots, R, D].
        knot: First of the four knots that count at this time.
        weights: Their weights, [4] float32. The gradient to each knot is that of the value times its weight.
    """
    return backend_of(controls).spline(controls, knot, weights)


def offsets(
    controls: tuple[Tensor, Tensor], knot: int, weights: np.ndarray, skin: Skin, unit: float
) -> tuple[Tensor, Tensor]:
    """Return dx [N, 3] and dq [N, 4] of points at one time, without gradients: the points' own splines plus those of their nodes.

    Args:
        controls: [knots, M, 7] of the nodes and [knots, N, 7] of the points: dx in units of `unit`, and dq without its identity.
        knot: First of the four knots that count.
        weights: Their weights, [4] float32.
        skin: Nodes of each point and their weights.
        unit: Length of one unit of the controls, world units.
    """
    return backend_of(controls[1]).offsets(controls, knot, weights, skin, unit)


def offsets_gradient(d_dx: Tensor, d_dq: Tensor, skin: Skin, nodes: int, unit: float) -> tuple[Tensor, Tensor]:
    """Return the gradients [M, 7] and [N, 7] to the values of the splines of M nodes and N points at one time.

    Args:
        d_dx: [N, 3], gradient to the dx that `offsets` returned.
        d_dq: [N, 4], gradient to the dq that `offsets` returned.
        skin: Nodes of each point and their weights.
        nodes: Number of nodes, M.
        unit: Length of one unit of the controls, world units.
    """
    return backend_of(d_dx).offsets_gradient(d_dx, d_dq, skin, nodes, unit)


def hashgrid(coords: Tensor, table: Tensor, resolutions: Tensor | np.ndarray) -> Tensor:
    """Return trilinear features [N, L * F] of every level of a multiresolution hash grid. Gradients go to table and coords.

    A level whose corners fit into T rows is stored densely. Other levels are hashed.

    Args:
        coords: [N, 3], clamped to 0..1.
        table: [L, T, F], T a power of two.
        resolutions: [L, 3] ints, cells along each axis.

    Raises:
        GaussiansError: The shapes do not fit.

    Source: Instant-NGP, section 3.
    """
    cells = np.ascontiguousarray(resolutions.cpu().numpy() if isinstance(resolutions, Tensor) else resolutions)
    size = table.shape[1]
    if cells.shape != (len(table), 3) or cells.min() < 1 or size & (size - 1):
        raise GaussiansError(
            f"hashgrid: table {tuple(table.shape)} and resolutions {cells.shape}, least {cells.min()}, do not fit; "
            "they must be [L, T, F], T a power of two, and [L, 3], at least 1."
        )
    return backend_of(coords).hashgrid(coords, table, cells)


def arap(means: Tensor, dx: Tensor, dq: Tensor, neighbor: Tensor, weights: Tensor, unit: float) -> Tensor:
    """Return the as-rigid-as-possible loss: neighbors should rotate alike, translate alike and keep their distance.

    Args:
        means: [N, 3]; gets no gradient.
        dx: [N, 3].
        dq: [N, 4].
        neighbor: [N] int64, one neighbor of every point.
        weights: [N]. The loss is the weighted mean over the points.
        unit: Length that distances are measured in, world units.

    Source: paper, section 4.2.
    """
    return backend_of(means).arap(means, dx, dq, neighbor, weights, unit)
