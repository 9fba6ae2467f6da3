"""Checks for Gaussians with finite but implausible values."""

from __future__ import annotations

import numpy as np

from splatreel.base.errors import GaussiansError
from splatreel.scene.gaussians import Gaussians

LIMITS = {"means": 1e12, "scales": 1e12, "sh": 1e4}
"""Maximum plausible values: world units, world units, and color coefficients, for which 1 is large."""


def check_plausible(points: Gaussians, what: str) -> Gaussians:
    """Return the Gaussians if all values are plausible.

    Args:
        points: Gaussians to check.
        what: Start of the message.

    Raises:
        GaussiansError: A value exceeds its limit. The message names the point and the value.
    """
    if not len(points):
        return points
    for name, limit in LIMITS.items():
        values = np.abs(getattr(points, name)).reshape(len(points), -1)
        if values.max() > limit:
            row = int(values.max(1).argmax())
            raise GaussiansError(
                f"{what}: {name} of point {row} (counted from 0) is {values[row].max():.3g}, beyond the {limit:g} that a reel can "
                f"hold. Remove that point from the file, or export it again."
            )
    return points
