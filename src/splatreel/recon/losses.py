"""Regularisers of group reconstruction (paper section 4.2): as rigid as possible, and smooth in time."""

from __future__ import annotations

import torch
from torch import Tensor

from splatreel.recon.deformation import Deformation
from splatreel.recon.density import rotate


def arap(means: Tensor, dx: Tensor, dq: Tensor, pairs: tuple[Tensor, Tensor], weights: Tensor, unit: float) -> Tensor:
    """L_arap: neighbours rotate alike, translate alike and keep their distance.

    means, dx: [N, 3]; dq: [N, 4]; pairs: two indices [P]; weights: [P], one over all when points coincide. Lengths are measured in
    `unit`, so that the weight means the same in millimetres and in metres. Mean over the pairs.
    """
    i, j = pairs
    dq = torch.nn.functional.normalize(dq, dim=-1)
    # Delta r, the translation once the rotation about the origin is taken out; about the pair's own middle it is well conditioned.
    middle = (means[i] + means[j]).detach() / 2
    a, b = means[i] - middle, means[j] - middle
    move_i = a + dx[i] - rotate(dq[i], a)
    move_j = b + dx[j] - rotate(dq[j], b)
    turn = (dq[i] - dq[j]).abs().sum(1)
    shift = (move_i - move_j).abs().sum(1) / unit
    before = (means[i] - means[j]).detach().norm(dim=1)
    after = (means[i].detach() + dx[i] - means[j].detach() - dx[j]).square().sum(1).add(1e-12).sqrt()
    return (weights * (turn + shift + (before - after).abs() / unit)).mean()


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
