"""Deformation models by the names of `GroupConfig.deformation`."""

from __future__ import annotations

import numpy as np

from splatreel.method.deform.hashgrid import HashGrid
from splatreel.method.deform.protocol import Deformation
from splatreel.method.deform.trajectory import Trajectory

MODELS = {"trajectory": Trajectory, "hashgrid": HashGrid}


def make_deformation(
    name: str,
    means: np.ndarray,
    frames: int,
    unit: float,
    seed: int,
    tracks: np.ndarray | None,
    fixed: np.ndarray | None,
) -> Deformation:
    """Create a model by its name. Without points it is `trajectory`, which needs none.

    Args:
        name: Key of `MODELS`.
        means: [N, 3] canonical positions.
        frames: Number of frames of the group, T.
        unit: Typical viewing distance, world units.
        seed: Seed of the initial values.
        tracks: [T, N, 3] initial positions; None is at rest.
        fixed: [N] bool, points that never move; None for none.
    """
    model = MODELS[name] if len(means) else Trajectory
    return model(means, frames, unit, seed, tracks, fixed)
