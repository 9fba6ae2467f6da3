"""What a reel says before any of its files: its clock, its box, its cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from splatreel.scene.camera import Camera
from splatreel.scene.clearance import NONE, Clearance
from splatreel.scene.untrusted import is_number, numbers

BLACK = (0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class ReelHeader:
    """The part of a manifest that is known before the first group (docs/format.md).

    fps: frames a second. group_length, overlap: frames of a group, and those that it shares with the next. sh_degree: the highest.
    bounds: [2, 3] box of the content, world units. up: [3] unit. camera: where a player starts. cameras: those it was filmed by.
    near: least depth to draw, world units. clearance: of static points. antialias: how splats are drawn (`render_image`).
    background: red, green and blue, 0..1, where nothing is; the light falls on it as well.
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

    def __post_init__(self) -> None:
        kinds = {"fps": float, "group_length": int, "overlap": int, "sh_degree": int, "near": float, "antialias": bool}
        for name, kind in kinds.items():
            object.__setattr__(self, name, kind(getattr(self, name)))
        for name in ("bounds", "up"):
            object.__setattr__(self, name, np.asarray(getattr(self, name), np.float64))
        object.__setattr__(self, "cameras", tuple(self.cameras))

    def to_dict(self) -> dict[str, Any]:
        """What `from_dict` takes, in numbers of full precision."""
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
        }

    @staticmethod
    def from_dict(value: dict[str, Any]) -> ReelHeader:
        """Of a checkpoint. Raises KeyError, TypeError, ValueError or `CaptureError` for what is none."""
        red, green, blue = value.get("background", BLACK)
        single = [value[name] for name in ("fps", "group_length", "overlap", "sh_degree")]
        if not all(is_number(number) for number in [*single, value.get("near", 0), red, green, blue]):
            raise TypeError("a number is none")
        numbers(value["bounds"], 2, 3)
        numbers(value["up"], 3)
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
        )
