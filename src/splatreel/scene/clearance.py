"""Clearance before a viewer: static points nearer than anything that a camera can have seen are not drawn."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from splatreel.scene.camera import Camera
from splatreel.scene.untrusted import is_number, numbers


@dataclass(frozen=True)
class Clearance:
    """Static points at less than `share` of the depth that `focus` [3], world units, has for a viewer are not drawn.

    Between cameras, and close to where a new one stands, hang splats that only distant cameras have seen, and there they only looked
    well. Where cameras stood, nothing was that near. Who walks into the scene comes closer to the focus, and sees what is near; and
    who turns away from it does, too.
    """

    focus: tuple[float, float, float] = (0.0, 0.0, 0.0)
    share: float = 0.0

    def to_dict(self) -> dict[str, Any]:
        return {"focus": list(self.focus), "share": self.share}

    @staticmethod
    def from_dict(value: dict[str, Any] | None) -> Clearance:
        """From JSON. None: everything is drawn. Raises KeyError, TypeError or ValueError for what is none."""
        if value is None:
            return NONE
        x, y, z = numbers(value["focus"], 3).tolist()
        if not is_number(value["share"]):
            raise TypeError("share is no number")
        return Clearance((x, y, z), value["share"])

    def depth(self, camera: Camera) -> float:
        """Up to which depth nothing that rests is drawn for a camera, world units."""
        return self.share * max(float(camera.viewmat[2, :3] @ np.asarray(self.focus) + camera.viewmat[2, 3]), 0.0)

    def hides(self, points: np.ndarray, camera: Camera) -> np.ndarray:
        """[N] bool: of points [N, 3], those in front of a camera that are within."""
        depths = points @ camera.viewmat[2, :3] + camera.viewmat[2, 3]
        return (depths > 0) & (depths < self.depth(camera))


NONE = Clearance()
"""Everything is drawn from the near plane on."""
