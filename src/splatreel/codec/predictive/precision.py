"""Precision of each point: quantization steps, and classes of points with coarser steps.

Every quantity is an integer multiple of a step. The steps of unimportant points are larger by a power of two. Its
exponent is the point's class, which is stored (docs/format.md).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, field, replace

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
_IMPORTANCE_EXPONENT = np.array([1.0, 1.0, 0.85])
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
    return np.clip(np.rint(octaves * _IMPORTANCE_EXPONENT), 0, coarsest_class(coarseness)).astype(np.int64)


@dataclass(frozen=True)
class Basis:
    """Basis of a `klt` section, and the coefficients that each point has in it.

    Attributes:
        vectors: Vectors, [D, K] int64, column k in units of 2^-shifts[k].
        shifts: [K].
        columns: Channel of each column of coefficients, [L]; None chooses the columns again.
        ends: Number of columns that each point has, [N]; None chooses it again.
    """

    vectors: np.ndarray
    shifts: Sequence[int]
    columns: np.ndarray | None = None
    ends: np.ndarray | None = None

    def __getitem__(self, index: np.ndarray | slice) -> Basis:
        """Return the basis for some of the points."""
        return self if self.ends is None else replace(self, ends=self.ends[index])


@dataclass(frozen=True)
class Precision:
    """Quantization of the points of a file. Decoded points that are encoded with it again lose little or nothing.

    Attributes:
        classes: Classes of shape, color and motion, [N, 3] int64.
        steps: Quantization steps by section, in the units of the section.
        cell: Cell width of the grid of positions, world units.
        finer: Refinement bits of a point of class 0.
        low: Origin of the grid, [3]; None uses the low corner of the points.
        bases: Bases of the `klt` sections. A section without one gets a new basis.
    """

    classes: np.ndarray
    steps: Mapping[str, float]
    cell: float
    finer: int
    low: np.ndarray | None = None
    bases: Mapping[str, Basis] = field(default_factory=dict)

    def __getitem__(self, index: np.ndarray | slice) -> Precision:
        """Return the precision of some of the points."""
        bases = {name: basis[index] for name, basis in self.bases.items()}
        return replace(self, classes=self.classes[index], bases=bases)

    def with_mixed_channels(self) -> Precision:
        """Return the precision after a rotation of the points, which gives other coefficients to each channel of motion."""
        mixed = {
            name: replace(basis, columns=None, ends=None) for name, basis in self.bases.items() if name in ("dx", "dq")
        }
        return replace(self, bases={**self.bases, **mixed}).without_bases("sh_rest")

    def without_bases(self, *names: str) -> Precision:
        """Return the precision without the bases of sections whose values a basis no longer fits."""
        return replace(self, bases={name: basis for name, basis in self.bases.items() if name not in names})


def choose_precision(
    scales: np.ndarray, importance: np.ndarray | None, coarseness: float, moving: bool, steps: Steps
) -> Precision:
    """Return the precision of new points.

    Args:
        scales: Standard deviations, [N, 3], world units.
        importance: Importance of shape, color and motion, [N, 3], see `classes_of`; None makes all equal.
        coarseness: Factor on all steps.
        moving: Offsets are stored too, so motion has its own class.
        steps: Quantization steps at a coarseness of 1.
    """
    size = float(np.exp(np.median(np.log(np.maximum(scales, 1e-30)))))
    finer = coarsest_class(coarseness)
    classes = classes_of(importance, len(scales), coarseness)
    if not moving:
        classes[:, MOTION] = classes[:, SHAPE]
    by_section = {
        "shapes": steps.shape * coarseness,
        "opacities": steps.opacity * coarseness,
        "sh_base": steps.color * coarseness,
        "sh_rest": steps.rest * coarseness,
        "dx": steps.motion * size * coarseness,
        "dq": steps.turn * coarseness,
        "shade": steps.shade * coarseness,
    }
    return Precision(classes, by_section, steps.position * coarseness * size * 2**finer, finer)
