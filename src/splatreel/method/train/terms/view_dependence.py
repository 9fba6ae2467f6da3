"""Price of colors that depend on the view."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from splatreel.kernels.adam import add_signs
from splatreel.method.train.terms.term import Iteration, Term


@dataclass(frozen=True)
class ViewDependence(Term[Iteration]):
    """L1 norm of the higher SH bands per pixel, beyond the paper. On moving things these bands learn mostly noise.

    sum over coefficients of  |sh| / pixels
    """

    wgsl: ClassVar[tuple[str, ...]] = ("unproject",)

    def value(self, seen: Iteration) -> float:
        """See `Term`."""
        return float(np.abs(seen.points["sh_rest"]).sum()) / seen.pixels

    def add_to_points(self, seen: Iteration, weight: float) -> None:
        """See `Term`. The gradient is added in place: it is the largest one."""
        rest = seen.points["sh_rest"]
        size = rest.shape[1] * rest.shape[2]
        if size:
            prices = np.full(size, weight / seen.pixels, np.float32)
            add_signs(rest.reshape(-1, size), prices, seen.gradients["sh_rest"].reshape(-1, size))
