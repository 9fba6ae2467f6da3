"""The deformation models by the names that `GroupConfig.deformation` knows."""

from __future__ import annotations

from torch import Tensor

from splatreel.recon.deform.hashgrid import HashGrid
from splatreel.recon.deform.protocol import Deformation
from splatreel.recon.deform.trajectory import Trajectory

MODELS = {"trajectory": Trajectory, "hashgrid": HashGrid}


def make_deformation(
    name: str, means: Tensor, frames: int, unit: float, seed: int, tracks: Tensor | None, fixed: Tensor | None
) -> Deformation:
    """The model of a name, for points at means [N, 3]. Where nothing moves it is `trajectory`, which needs no points.

    frames: of the group. unit: viewing distance, world units. tracks: [T, N, 3] positions to start from. fixed: [N] bool, which rest.
    """
    model = MODELS[name] if len(means) else Trajectory
    return model(means, frames, unit, seed, tracks, fixed)
