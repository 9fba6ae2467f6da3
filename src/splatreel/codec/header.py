"""Properties of a reel that do not depend on its files: frame rate, bounds, cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from splatreel.base.untrusted import is_number, numbers
from splatreel.scene.camera import Camera
from splatreel.scene.clearance import NONE, Clearance
from splatreel.scene.reel_source import ReelSource, parse_reel_source

BLACK = (0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class ReelHeader:
    """Part of a manifest that is known before the first group (docs/format.md).

    Attributes:
        group_length: Frames per group, without the overlap.
        overlap: Frames that a group shares with the next one.
        sh_degree: Highest SH degree.
        bounds: Box of the content, [2, 3], world units.
        up: Unit up direction, [3].
        camera: Start camera of a player.
        cameras: Training cameras.
        near: Minimum depth that is drawn, world units.
        clearance: Clearance of static points.
        antialias: How splats are drawn, see `render_image`.
        background: Red, green and blue, 0..1, behind the points. The light of groups applies to it too.
        origin: Position of the reel's origin in the coordinates of its source, [3] float64. Exports add it.
        transparent: The player shows the page behind the points. Images without transparency have the background.
        source: Frames and cameras of the capture that the reel was made from; None if unknown, as for an import.
    """

    fps: float
    group_length: int
    overlap: int
    sh_degree: int
    bounds: np.ndarray
    up: np.ndarray
    camera: Camera
    cameras: Sequence[Camera]
    near: float = 0.01
    clearance: Clearance = NONE
    antialias: bool = False
    background: tuple[float, float, float] = BLACK
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))
    transparent: bool = False
    source: ReelSource | None = None

    def __post_init__(self) -> None:
        kinds = {"fps": float, "group_length": int, "overlap": int, "sh_degree": int, "near": float, "antialias": bool}
        for name, kind in kinds.items():
            object.__setattr__(self, name, kind(getattr(self, name)))
        for name in ("bounds", "up", "origin"):
            object.__setattr__(self, name, np.asarray(getattr(self, name), np.float64))
        object.__setattr__(self, "cameras", tuple(self.cameras))

    def to_dict(self) -> dict[str, Any]:
        """Return the dictionary that `from_dict` accepts, with numbers in full precision."""
        return {
            "fps": self.fps,
            "group_length": self.group_length,
            "overlap": self.overlap,
            "sh_degree": self.sh_degree,
            "bounds": self.bounds.tolist(),
            "up": self.up.tolist(),
            "camera": self.camera.to_dict(),
            "cameras": [camera.to_dict() for camera in self.cameras],
            "near": self.near,
            "clearance": self.clearance.to_dict(),
            "antialias": self.antialias,
            "background": list(self.background),
            **({"origin": self.origin.tolist()} if self.origin.any() else {}),
            **({"transparent": True} if self.transparent else {}),
            **({"source": self.source.to_dict()} if self.source else {}),
        }

    @staticmethod
    def from_dict(value: dict[str, Any]) -> ReelHeader:
        """Return the header of a checkpoint.

        Raises:
            KeyError: A field is missing.
            TypeError: A field has the wrong type.
            ValueError: A value is invalid.
            CaptureError: A camera is invalid.
        """
        red, green, blue = value.get("background", BLACK)
        single = [value[name] for name in ("fps", "group_length", "overlap", "sh_degree")]
        if not all(is_number(number) for number in [*single, value.get("near", 0), red, green, blue]):
            raise TypeError("a number is none")
        numbers(value["bounds"], 2, 3)
        numbers(value["up"], 3)
        origin = numbers(value.get("origin", [0, 0, 0]), 3)
        return ReelHeader(
            fps=value["fps"],
            group_length=value["group_length"],
            overlap=value["overlap"],
            sh_degree=value["sh_degree"],
            bounds=np.array(value["bounds"]),
            up=np.array(value["up"]),
            camera=Camera.from_dict(value["camera"]),
            cameras=tuple(Camera.from_dict(camera) for camera in value["cameras"]),
            near=value.get("near", 0.01),
            clearance=Clearance.from_dict(value.get("clearance")),
            antialias=value.get("antialias", False),
            background=(red, green, blue),
            origin=origin,
            transparent=value.get("transparent", False) is True,
            source=parse_reel_source(value.get("source")),
        )
