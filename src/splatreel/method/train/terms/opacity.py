"""Price of opacity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from splatreel.method.train.terms.term import Iteration, Term


@dataclass(frozen=True)
class Opacity(Term[Iteration]):
    """Sum of all opacities per pixel, beyond the paper. Points that explain little fade, floaters first.

    sum over points of  sigmoid(logit) / pixels
    """

    wgsl: ClassVar[tuple[str, ...]] = ("unproject",)

    def value(self, seen: Iteration) -> float:
        """See `Term`."""
        return float(_opacities(seen).sum()) / seen.pixels

    def add_to_points(self, seen: Iteration, weight: float) -> None:
        """See `Term`."""
        opaque = _opacities(seen)
        seen.add("logit_opacities", np.float32(weight / seen.pixels) * opaque * (1 - opaque))


def _opacities(seen: Iteration) -> np.ndarray:
    """Return the opacities [N], as the kernels compute them."""
    return 1 / (1 + np.exp(np.minimum(-seen.points["logit_opacities"], np.float32(80))))
