"""Precision of each point: quantization steps, and classes of points with coarser steps.

Every quantity is an integer multiple of a step. The steps of unimportant points are larger by a power of two. Its
exponent is the point's class, which is stored (docs/format.md).
"""

from __future__ import annotations

from dataclasses import astuple, dataclass

import numpy as np


@dataclass(frozen=True)
class Steps:
    """Quantization steps of the most important points at `EncodeConfig.coarseness` 1.

    `position` and `motion` are multiples of the points' typical size, `turn` is in radians, `shape` in octaves
    (`covariance`).
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
"""Exponents for shape, color and motion: steps grow with this power of falling importance. An exponent below 1 for motion improved
held-out views.
"""
SHAPE, COLOR, MOTION = range(3)
RELATIVE = np.array([0, 1, 1])
"""1 where a class is stored relative to that of shape: points are usually unimportant in all respects."""


def coarsest_class(coarseness: float) -> int:
    """Return the largest class that the encoder assigns. A larger error would be visible even for unimportant points."""
    return 2 if coarseness > 1 else 3


def classes_of(importance: np.ndarray | None, count: int, coarseness: float = 1.0) -> np.ndarray:
    """Return classes [N, 3] int64. Steps grow as importance [N, 3] falls below its 90th percentile; None gives class 0."""
    if importance is None:
        return np.zeros((count, 3), np.int64)
    top = np.maximum(np.quantile(importance, 0.9, axis=0), 1e-30)
    octaves = np.log2(top / np.maximum(importance, top * 1e-6))
    return np.clip(np.rint(octaves * IMPORTANCE_EXPONENT), 0, coarsest_class(coarseness)).astype(np.int64)
