"""Clearance: static Gaussians closer to a viewer than any surface the cameras saw are not drawn."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from splatreel.base.untrusted import is_number, numbers
from splatreel.scene.camera import Camera


@dataclass(frozen=True)
class Clearance:
    """Rule that hides static Gaussians nearer than `share` times the viewer's depth of `focus`.

    Floaters hang between cameras and close to novel viewpoints. Only distant cameras saw them, and they look wrong from
    nearby. No training camera saw a surface that near. The hidden range shrinks as a viewer approaches the focus or
    turns away from it.

    Attributes:
        focus: Point the cameras look at, [3] world units.
        share: Share of the depth of `focus`, 0..1; 0 hides nothing.
    """

    focus: tuple[float, float, float] = (0.0, 0.0, 0.0)
    share: float = 0.0

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON value that `from_dict` accepts."""
        return {"focus": list(self.focus), "share": self.share}

    @staticmethod
    def from_dict(value: dict[str, Any] | None) -> Clearance:
        """Return a clearance from JSON; None means that everything is drawn.

        Raises:
            KeyError: A field is missing.
            TypeError: A field has the wrong type.
            ValueError: A number is invalid.
        """
        if value is None:
            return NONE
        x, y, z = numbers(value["focus"], 3).tolist()
        if not is_number(value["share"]):
            raise TypeError("share is not a number")
        return Clearance((x, y, z), value["share"])

    def depth(self, camera: Camera) -> float:
        """Return the depth in world units up to which static Gaussians are hidden from a camera."""
        return self.share * max(float(camera.viewmat[2, :3] @ np.asarray(self.focus) + camera.viewmat[2, 3]), 0.0)

    def hides(self, points: np.ndarray, camera: Camera) -> np.ndarray:
        """Return which points [N, 3] lie in front of a camera within the clearance, [N] bool."""
        depths = points @ camera.viewmat[2, :3] + camera.viewmat[2, 3]
        return (depths > 0) & (depths < self.depth(camera))


NONE = Clearance()
"""No clearance: everything beyond the near plane is drawn."""
