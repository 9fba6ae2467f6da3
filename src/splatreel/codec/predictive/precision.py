"""How precisely each point is coded: steps of quantization, and classes of points whose steps are coarser.

Every quantity is a multiple of a step. Points that hardly show get steps that are a power of two larger; which one is their class,
and is stored (docs/format.md).
"""

from __future__ import annotations

from dataclasses import astuple, dataclass

import numpy as np


@dataclass(frozen=True)
class Steps:
    """Steps of the most important points at `EncodeConfig.coarseness` 1.

    position and motion are in multiples of the points' typical size, turn is in radians, shape in octaves (`covariance`).
    """

    position: float = 0.028
    motion: float = 0.18
    turn: float = 0.06
    shape: float = 0.065
    opacity: float = 0.01
    color: float = 0.025
    rest: float = 0.016
    shade: float = 0.12

    def scaled(self, factor: float) -> Steps:
        """Return all steps multiplied by a factor."""
        return Steps(*(factor * self.to_array()).tolist())

    def to_array(self) -> np.ndarray:
        """Return the steps as [8] float64, in the order of the fields."""
        return np.array(astuple(self))


STEPS = Steps()
IMPORTANCE_EXPONENT = np.array([1.0, 1.0, 0.85])
"""Of shape, color and motion: steps grow with this power of falling importance; below 1 was better for motion on held-out views."""
COARSEST = 3, 2
"""The largest class an encoder gives at a coarseness up to 1, and above: a larger error would show even where little does."""
SHAPE, COLOR, MOTION = range(3)
RELATIVE = np.array([0, 1, 1])
"""Classes of color and motion are stored less that of shape: a point that hardly shows does so in every respect."""


def classes_of(importance: np.ndarray | None, count: int, coarseness: float = 1.0) -> np.ndarray:
    """Classes [N, 3] int64: steps grow as importance [N, 3] falls below its 90th percentile. None: all 0."""
    if importance is None:
        return np.zeros((count, 3), np.int64)
    top = np.maximum(np.quantile(importance, 0.9, axis=0), 1e-30)
    octaves = np.log2(top / np.maximum(importance, top * 1e-6))
    return np.clip(np.rint(octaves * IMPORTANCE_EXPONENT), 0, COARSEST[coarseness > 1]).astype(np.int64)
