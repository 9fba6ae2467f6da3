"""Measures of a scene, its up direction included, and limits of viewpoints. Learning rates and thresholds are relative to them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from scipy.sparse.csgraph import minimum_spanning_tree

from splatreel.base.untrusted import is_number, numbers
from splatreel.codec.presentation import Limits
from splatreel.method.init.planesweep import seen_depths
from splatreel.scene.camera import Camera
from splatreel.scene.clearance import NONE, Clearance
from splatreel.scene.volumes import Volume, parse_volume

BORDER_PARTS = 8
"""Each side of an image's border is one part in this many of its width or height."""
CLEAR_SHARE, MAX_CLEAR_SHARE = 0.85, 0.35
"""Clearance is this share of the free space in front of the cameras, but at most `MAX_CLEAR_SHARE` of the distance to the focus."""
ROLL_SCALES = [math.sin(math.radians(angle)) for angle in (45, 30, 20, 12, 12, 12, 12)]
"""Sine of the roll at which a camera's weight falls, per iteration. The first direction is rough and must not reject good
cameras."""
MEAN_WEIGHT = 0.01
"""Weight of the mean of the cameras' up vectors relative to one camera: (3 / 30)^2, from typical degrees of roll and of error
of that mean."""
LEVEL_SINE, LEVEL_CAMERAS = 0.5, 0.6
"""Maximum sine of the roll of a level camera, and share of the cameras that must be level for right axes to be used."""


@dataclass(frozen=True)
class Layout:
    """Measures of a scene.

    Attributes:
        near: Near plane, world units.
        unit: Typical viewing distance, world units.
        clearance: Space in front of a viewer in which no static point is drawn.
        backgrounds: Color behind the subject in the images of each camera, for a capture with masks. It does not change with the
            camera's color gain.
        region: Volume that the reel holds, as users write it; empty for everything.
    """

    near: float
    unit: float
    up: list[float]
    bounds: list[list[float]]
    clearance: Clearance = NONE
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    backgrounds: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    region: str = ""

    @property
    def is_partial(self) -> bool:
        """True if the reel leaves a part of the scene out."""
        return bool(self.backgrounds or self.region)

    def background_of(self, camera: Camera, gain: np.ndarray) -> tuple[float, float, float]:
        """Return the color behind all points in an image before the camera's color gain [3], 0..1."""
        if camera.name not in self.backgrounds:
            return self.background
        red, green, blue = (np.array(self.backgrounds[camera.name]) / gain).tolist()
        return red, green, blue

    def volume(self, cameras: Sequence[Camera]) -> Volume | None:
        """Return the volume that the reel of these training cameras holds; None for everything."""
        return (
            parse_volume("region", self.region, _VolumeRig(np.array(self.up), cameras, self.near))
            if self.region
            else None
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the layout as JSON values."""
        return asdict(self) | {"clearance": self.clearance.to_dict(), "background": list(self.background)}

    @staticmethod
    def from_dict(value: dict[str, Any]) -> Layout:
        """Parse the result of `to_dict`. Other values raise a KeyError, TypeError or ValueError."""
        numbers(value["up"], 3)
        numbers(value["bounds"], 2, 3)
        if not (is_number(value["near"]) and is_number(value["unit"]) and isinstance(value.get("region", ""), str)):
            raise TypeError("near or unit is not a number, or region is not text")
        plain = {name: value[name] for name in value if name not in ("clearance", "background", "backgrounds")}
        clearance = Clearance.from_dict(value.get("clearance"))
        behind = {name: _color(color) for name, color in dict(value.get("backgrounds", {})).items()}
        background = _color(value.get("background", [0.0, 0.0, 0.0]))
        return replace(Layout(**plain), clearance=clearance, background=background, backgrounds=behind)


def _color(value: Any) -> tuple[float, float, float]:
    red, green, blue = numbers(value, 3).tolist()
    return red, green, blue


@dataclass(frozen=True)
class _VolumeRig:
    up: np.ndarray
    cameras: Sequence[Camera]
    near: float


def check_region(text: str, cameras: Sequence[Camera]) -> None:
    """Raise a `UsageError` if the text of a region is not a volume."""
    if text:
        parse_volume("region", text, _VolumeRig(upright(cameras), cameras, 0.0))


def measure(cameras: list[Camera], points: np.ndarray, near: float) -> Layout:
    """Measure a scene by its training cameras and initial points [P, 3]."""
    low, high = np.percentile(points, [5, 95], axis=0)
    return Layout(
        near=float(near),
        unit=viewing_distance(cameras, points),
        up=[float(v) for v in upright(cameras)],
        bounds=[[float(v) for v in low], [float(v) for v in high]],
        clearance=clearance_of(cameras, points),
    )


def clearance_of(cameras: list[Camera], points: np.ndarray) -> Clearance:
    """Return the free space in front of all cameras. One in 200 of the points that each camera sees may be nearer.

    The focus is the mean of the points on the cameras' axes at the typical viewing distance.
    """
    unit = viewing_distance(cameras, points)
    focus = np.mean([camera.center + unit * camera.viewmat[2, :3] for camera in cameras], axis=0)
    whole = Clearance((float(focus[0]), float(focus[1]), float(focus[2])), 1.0)
    nearest = [
        np.percentile(depths, 0.5) / whole.depth(camera)
        for camera, depths in zip(cameras, seen_depths(cameras, points), strict=True)
        if len(depths) and whole.depth(camera) > 0
    ]
    share = min(CLEAR_SHARE * min(nearest, default=0.0), MAX_CLEAR_SHARE)
    return replace(whole, share=float(share))


def border_color(images: np.ndarray) -> tuple[float, float, float]:
    """Return the mean color near the borders of images [C, H, W, 3] uint8, 0..1. Unseen places beyond them likely look alike."""
    height, width = images.shape[1:3]
    border = np.ones((height, width), bool)
    above, left = height // BORDER_PARTS, width // BORDER_PARTS
    border[above : height - above, left : width - left] = False
    red, green, blue = (round(value / 255, 4) for value in images[:, border].mean((0, 1)).tolist())
    return red, green, blue


def viewing_distance(cameras: list[Camera], points: np.ndarray) -> float:
    """Return the median over the cameras of the median depth of the points each one sees."""
    medians = [float(np.median(depths)) for depths in seen_depths(cameras, points) if len(depths)]
    return float(np.median(medians)) if medians else 1.0


def upright(cameras: Sequence[Camera]) -> np.ndarray:
    """Return the unit up direction [3], perpendicular to the cameras' right axes as far as these determine it.

    A level camera's right axis is horizontal for any tilt. The mean of the up vectors leans instead, since cameras that look
    down lean forward together. The result u minimizes sum w (right u)^2 + MEAN_WEIGHT |u - mean|^2. The mean thus decides for a
    single camera, for parallel cameras and for cameras rolled at random. The weight w is small for rolled cameras.
    """
    rights = np.stack([camera.viewmat[0, :3] for camera in cameras])
    ups = -np.stack([camera.viewmat[1, :3] for camera in cameras])
    up = mean = _unit(ups.mean(0))
    for scale in ROLL_SCALES:
        weights = 1 / (1 + (rights @ up / scale) ** 2) ** 2
        spread = (rights * weights[:, None]).T @ rights
        up = _unit(np.linalg.solve(spread + MEAN_WEIGHT * np.eye(3), weights @ ups))
    return up if np.mean(np.abs(rights @ up) < LEVEL_SINE) >= LEVEL_CAMERAS else mean


def up_angles(cameras: Sequence[Camera]) -> list[float]:
    """Return the angle of the scene's up direction in the image of each camera, radians clockwise from the image's up."""
    up = upright(cameras)
    ups = [camera.viewmat[:3, :3] @ up for camera in cameras]
    return [float(np.arctan2(up[0], -up[1])) for up in ups]


def _unit(vector: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vector)
    return vector / length if length > 1e-6 else np.array([0.0, 0.0, 1.0])


MOST_CAMERAS = 0.9
"""Share of the cameras that must look at the focus, and quantile of the steps between neighboring cameras that decides the
angle."""
MIN_LOOKING_COSINE = 0.7
"""Minimum cosine of the angle between a camera's axis and the focus, for a camera that looks at it."""
STEP_SHARE, MARGIN_DEGREES, LEAST_DEGREES, MOST_DEGREES = 0.75, 5.0, 10.0, 45.0
"""The angle is `STEP_SHARE` of a step from camera to camera (half a step is the middle between two) plus `MARGIN_DEGREES`,
clamped to `LEAST_DEGREES`..`MOST_DEGREES`."""
NEAREST, FARTHEST = 0.25, 1.25
"""Limits of the distance, as shares of the smallest and the largest distance of a camera from the focus."""
FLOOR_PERCENTILE = 2.0
"""Percentage of the points around the focus that may lie below the floor: noise and reflections."""
MIN_FLOOR_POINTS = 100
"""Minimum number of points that determine a floor."""


def limits(cameras: Sequence[Camera], points: np.ndarray, layout: Layout, most: float | None = None) -> Limits | None:
    """Return the limits of viewpoints for cameras around a subject; None for cameras that do not look at a common focus.

    Views between neighboring cameras hold, and about as far beyond the outer ones. The angle follows from the steps of
    the shortest path through all cameras. The floor lies below nearly all points around the focus and below every
    camera. `most` limits the angle, degrees, if a trial showed that views do not hold (`method/prediction/trial.py`).
    """
    focus, up = np.array(layout.clearance.focus), np.array(layout.up)
    centers = np.stack([camera.center for camera in cameras]).astype(np.float64)
    away = centers - focus
    distances = np.linalg.norm(away, axis=1)
    if distances.min() < 1e-6:
        return None
    directions = away / distances[:, None]
    ahead = np.stack([camera.viewmat[2, :3] for camera in cameras])
    if np.mean((ahead * -directions).sum(1) > MIN_LOOKING_COSINE) < MOST_CAMERAS:
        return None
    angle = _angle(directions)
    return Limits(
        focus=layout.clearance.focus,
        angle=angle if most is None else min(angle, most),
        distance=(round(NEAREST * float(distances.min()), 6), round(FARTHEST * float(distances.max()), 6)),
        floor=_floor(points, centers @ up, focus, up, 2 * distances.max()),
    )


def _angle(directions: np.ndarray) -> float:
    """Return the angle, degrees, for unit directions [C, 3] from the focus to the cameras."""
    between = np.degrees(np.arccos(np.clip(directions @ directions.T, -1, 1)))
    steps = minimum_spanning_tree(between).data
    step = float(np.quantile(steps, MOST_CAMERAS, method="lower")) if len(steps) else 0.0
    return round(min(max(STEP_SHARE * step + MARGIN_DEGREES, LEAST_DEGREES), MOST_DEGREES), 2)


def _floor(points: np.ndarray, cameras: np.ndarray, focus: np.ndarray, up: np.ndarray, radius: float) -> float | None:
    """Return the height of the floor along `up`, below all cameras; None for too few points within a radius of the focus."""
    around = points[np.linalg.norm(points - focus, axis=1) < radius]
    if len(around) < MIN_FLOOR_POINTS:
        return None
    return round(min(float(np.percentile(around @ up, FLOOR_PERCENTILE)), float(cameras.min())), 6)
