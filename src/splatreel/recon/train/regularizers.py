"""What keeps motion plausible (paper section 4.2): as rigid as possible, and smooth in time."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from splatreel.kernels import motion, splat
from splatreel.recon.deform.protocol import Deformation


@dataclass(frozen=True)
class Neighbors:
    """The K nearest neighbors of N points, by rank. index: [K, N] int64. closeness: [K, N], 1 where the two coincide."""

    index: Tensor
    closeness: Tensor

    @staticmethod
    def of(means: Tensor, count: int) -> Neighbors | None:
        """Up to `count` for each of means [N, 3]; None of a point that is alone. Far ones count less."""
        if len(means) < 2:
            return None
        index, distance = splat.nearest_neighbors(means.detach(), min(count, len(means) - 1))
        width = 2 * distance[:, -1:].median().clamp_min(1e-9)
        closeness = torch.exp(-((distance / width) ** 2))
        return Neighbors(index.T.contiguous(), closeness.T.contiguous())  # an iteration draws one rank of all


def arap(means: Tensor, dx: Tensor, dq: Tensor, neighbor: Tensor, weights: Tensor, unit: float) -> Tensor:
    """L_arap: neighbors rotate alike, translate alike and keep their distance.

    means, dx: [N, 3]; dq: [N, 4]; neighbor: [N] a neighbor of every point; weights: [N]. Lengths are measured in `unit`, so that the
    loss means the same in millimeters and in meters. Only the offsets get gradients. Mean over points.
    """
    return motion.arap(means.detach(), dx, dq, neighbor, weights, unit)


def temporal(model: Deformation, means: Tensor, frame: float, other: float, delta: float, unit: float) -> Tensor:
    """L_temp: between two close frames, offsets are linear in time.

    The last term of the printed formula mixes an offset with a position; it is read as the offset at frame + delta (other - frame).
    Mean over the points.
    """
    dx0, dq0 = model.offsets(means, frame)
    dx1, dq1 = model.offsets(means, other)
    dx, dq = model.offsets(means, frame + delta * (other - frame))
    position = ((1 - delta) * dx0 + delta * dx1 - dx).abs().sum(1) / unit
    rotation = ((1 - delta) * dq0 + delta * dq1 - dq).abs().sum(1)
    return (position + rotation).mean()
