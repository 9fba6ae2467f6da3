"""Numbers of Gaussians that are finite, and still accidents."""

from __future__ import annotations

import numpy as np

from splatreel.errors import GaussiansError
from splatreel.scene.gaussians import Gaussians

LIMITS = {"means": 1e12, "scales": 1e12, "sh": 1e4}
"""Beyond them numbers are accidents: world units, world units, and coefficients of color, where 1 is much."""


def check_plausible(points: Gaussians, what: str) -> Gaussians:
    """Return Gaussians whose numbers a renderer can do something with. Raises `GaussiansError` that names the point and the value.

    what: begins the message.
    """
    if not len(points):
        return points
    for name, limit in LIMITS.items():
        values = np.abs(getattr(points, name)).reshape(len(points), -1)
        if values.max() > limit:
            row = int(values.max(1).argmax())
            raise GaussiansError(
                f"{what}: {name} of point {row} (counted from 0) is {values[row].max():.3g}, beyond the {limit:g} that a reel can "
                f"hold. Take that point out of the file, or export it again."
            )
    return points
