"""How a capture lies in space: measures that every learning rate and threshold is relative to."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from splatreel.recon.init.planesweep import seen_depths
from splatreel.recon.init.upright import upright
from splatreel.scene.camera import Camera
from splatreel.scene.clearance import NONE, Clearance
from splatreel.scene.untrusted import is_number, numbers

BORDER = 8
"""The part of a picture's width and height that its border takes on each side."""
CLEAR, MOST_CLEAR = 0.85, 0.35
"""How much is taken to be free of what rests: of the room that cameras have before them, and at most of their distance to the focus."""


@dataclass(frozen=True)
class Layout:
    """near: near plane; unit: typical viewing distance (both world units); up: unit vector; bounds: low and high corner.

    clearance: of static points; background: red, green and blue where nothing is, 0..1.
    """

    near: float
    unit: float
    up: list[float]
    bounds: list[list[float]]
    clearance: Clearance = NONE
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def to_dict(self) -> dict[str, Any]:
        return asdict(self) | {"clearance": self.clearance.to_dict(), "background": list(self.background)}

    @staticmethod
    def from_dict(value: dict[str, Any]) -> Layout:
        """Raises KeyError, TypeError or ValueError for what is none."""
        numbers(value["up"], 3)
        numbers(value["bounds"], 2, 3)
        if not (is_number(value["near"]) and is_number(value["unit"])):
            raise TypeError("near or unit is no number")
        plain = {name: value[name] for name in value if name not in ("clearance", "background")}
        red, green, blue = numbers(value.get("background", [0.0, 0.0, 0.0]), 3).tolist()
        clearance = Clearance.from_dict(value.get("clearance"))
        return replace(Layout(**plain), clearance=clearance, background=(red, green, blue))


def measure(cameras: list[Camera], points: np.ndarray, near: float) -> Layout:
    """Lay out a capture from its training cameras and initial points [P, 3]."""
    low, high = np.percentile(points, [5, 95], axis=0)
    return Layout(
        near=float(near),
        unit=viewing_distance(cameras, points),
        up=[float(v) for v in upright(cameras)],
        bounds=[[float(v) for v in low], [float(v) for v in high]],
        clearance=clearance_of(cameras, points),
    )


def clearance_of(cameras: list[Camera], points: np.ndarray) -> Clearance:
    """The room that all cameras had before them, nearly: one in 200 of the points that each one sees may be nearer.

    The focus is the mean of what the cameras look at, as far away as they typically look.
    """
    unit = viewing_distance(cameras, points)
    focus = np.mean([camera.center + unit * camera.viewmat[2, :3] for camera in cameras], axis=0)
    whole = Clearance((float(focus[0]), float(focus[1]), float(focus[2])), 1.0)
    nearest = [
        np.percentile(depths, 0.5) / whole.depth(camera)
        for camera, depths in zip(cameras, seen_depths(cameras, points), strict=True)
        if len(depths) and whole.depth(camera) > 0
    ]
    share = min(CLEAR * min(nearest, default=0.0), MOST_CLEAR)
    return replace(whole, share=float(share))


def border_color(images: np.ndarray) -> tuple[float, float, float]:
    """Red, green and blue, 0..1, of pictures [C, H, W, 3] uint8 near their borders, on average: what goes on beyond is likely alike."""
    height, width = images.shape[1:3]
    border = np.ones((height, width), bool)
    border[height // BORDER : height - height // BORDER, width // BORDER : width - width // BORDER] = False
    red, green, blue = (round(value / 255, 4) for value in images[:, border].mean((0, 1)).tolist())
    return red, green, blue


def viewing_distance(cameras: list[Camera], points: np.ndarray) -> float:
    """Median over the cameras of the median depth of the points each one sees."""
    medians = [float(np.median(depths)) for depths in seen_depths(cameras, points) if len(depths)]
    return float(np.median(medians)) if medians else 1.0
