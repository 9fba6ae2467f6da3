"""Regularizers of motion (paper section 4.2): rigidity and smoothness in time."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from splatreel.kernels import motion, splat
from splatreel.recon.deform.protocol import Deformation


@dataclass(frozen=True)
class Neighbors:
    """The K nearest neighbors of N points, by rank.

    Attributes:
        index: [K, N] int64.
        closeness: [K, N], 1 where two points coincide.
    """

    index: Tensor
    closeness: Tensor

    @staticmethod
    def of(means: Tensor, count: int) -> Neighbors | None:
        """Find up to `count` neighbors for each of the means [N, 3]; return None for fewer than two points."""
        if len(means) < 2:
            return None
        index, distance = splat.nearest_neighbors(means.detach(), min(count, len(means) - 1))
        width = 2 * distance[:, -1:].median().clamp_min(1e-9)
        closeness = torch.exp(-((distance / width) ** 2))
        return Neighbors(index.T.contiguous(), closeness.T.contiguous())  # an iteration uses one rank of all points


def arap(means: Tensor, dx: Tensor, dq: Tensor, neighbor: Tensor, weights: Tensor, unit: float) -> Tensor:
    """Return L_arap, mean over points: neighbors share rotation and translation, and keep their distance.

    Only the offsets get gradients.

    Args:
        means: [N, 3] positions.
        dx: [N, 3] position offsets.
        dq: [N, 4] rotation offsets.
        neighbor: [N] one neighbor of every point.
        weights: [N] weight of each pair.
        unit: Length that distances are divided by, so that the loss does not depend on world units.
    """
    return motion.arap(means.detach(), dx, dq, neighbor, weights, unit)


def temporal(model: Deformation, means: Tensor, frame: float, other: float, delta: float, unit: float) -> Tensor:
    """Return L_temp, mean over points: between two close frames, offsets are linear in time.

    The last term of the printed formula mixes an offset with a position. It is read as the offset at frame + delta (other -
    frame).

    Args:
        model: Deformation model.
        means: [N, 3] positions.
        frame: First frame.
        other: Second frame.
        delta: Position of the sample between the two frames, 0..1.
        unit: Typical viewing distance, world units.
    """
    dx0, dq0 = model.offsets(means, frame)
    dx1, dq1 = model.offsets(means, other)
    dx, dq = model.offsets(means, frame + delta * (other - frame))
    position = ((1 - delta) * dx0 + delta * dx1 - dx).abs().sum(1) / unit
    rotation = ((1 - delta) * dq0 + delta * dq1 - dq).abs().sum(1)
    return (position + rotation).mean()
