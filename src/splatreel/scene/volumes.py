"""Volumes that contain points or not: box, sphere, upright cylinder, and what many cameras see; and their texts (`sphere:0,1,0,2`)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from splatreel.base.errors import UsageError
from splatreel.scene.camera import Camera


class Volume(Protocol):
    """Part of space."""

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Return which points [..., 3] are inside, [...] bool."""
        ...

    def bounds(self) -> np.ndarray | None:
        """Return the box around the volume, [2, 3]; None if it has no simple one."""
        ...


@dataclass(frozen=True)
class Box:
    """Box with axes of the world, from its low to its high corner, [3] each."""

    low: np.ndarray
    high: np.ndarray

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Return which points [..., 3] are inside, [...] bool."""
        return np.all((points >= self.low) & (points <= self.high), axis=-1)

    def bounds(self) -> np.ndarray:
        """Return the corners, [2, 3]."""
        return np.stack([self.low, self.high])


@dataclass(frozen=True)
class Sphere:
    """Sphere around a center, [3]."""

    center: np.ndarray
    radius: float

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Return which points [..., 3] are inside, [...] bool."""
        return np.square(points - self.center).sum(-1) <= self.radius**2

    def bounds(self) -> np.ndarray:
        """Return the box around the sphere, [2, 3]."""
        return np.stack([self.center - self.radius, self.center + self.radius])


@dataclass(frozen=True)
class Cylinder:
    """Cylinder that stands on the middle of its base, [3], along a unit direction `up` [3]."""

    base: np.ndarray
    up: np.ndarray
    radius: float
    height: float

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Return which points [..., 3] are inside, [...] bool."""
        away = points - self.base
        along = away @ self.up
        beside = np.square(away).sum(-1) - along**2
        return (along >= 0) & (along <= self.height) & (beside <= self.radius**2)

    def bounds(self) -> np.ndarray:
        """Return the box around the cylinder, [2, 3]."""
        across = self.radius * np.sqrt(np.maximum(1 - self.up**2, 0))
        ends = np.stack([self.base, self.base + self.height * self.up])
        return np.stack([ends.min(0) - across, ends.max(0) + across])


@dataclass(frozen=True)
class CaptureVolume:
    """Space in the images of at least a share of the cameras, beyond the depth `near` of each."""

    cameras: Sequence[Camera]
    near: float
    share: float = 0.5

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Return which points [..., 3] are inside, [...] bool."""
        seen = np.zeros(points.shape[:-1], np.int64)
        for camera in self.cameras:
            seen += in_image(points, camera, self.near)[0]
        return seen >= max(self.share * len(self.cameras), 1)

    def bounds(self) -> None:
        """Return None: the volume may have no end."""
        return


@dataclass(frozen=True)
class Outside:
    """Everything outside of a volume."""

    volume: Volume

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Return which points [..., 3] are outside of the volume, [...] bool."""
        return ~self.volume.contains(points)

    def bounds(self) -> None:
        """Return None: the outside has no end."""
        return


def in_image(points: np.ndarray, camera: Camera, near: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Project points [..., 3] into a camera.

    Returns:
        Which points are in the image and deeper than `near`, [...] bool; their pixels, [..., 2]; their depths, [...].
    """
    seen = points @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
    depth = seen[..., 2]
    ahead = depth > near
    pixels = seen @ camera.K.T
    pixels = pixels[..., :2] / np.where(ahead, depth, 1)[..., None]
    inside = ((pixels >= 0) & (pixels < (camera.width, camera.height))).all(-1)
    return ahead & inside, pixels, depth


_VOLUMES = (
    "box:x,y,z,X,Y,Z, sphere:x,y,z,RADIUS, cylinder:x,y,z,RADIUS,HEIGHT (x,y,z is the middle of its base) or capture"
)


class VolumeRig(Protocol):
    """Facts that some volumes depend on: the header of a reel has them."""

    @property
    def up(self) -> np.ndarray:
        """Up direction, [3]."""
        ...

    @property
    def cameras(self) -> Sequence[Camera]:
        """Cameras of the capture."""
        ...

    @property
    def near(self) -> float:
        """Minimum depth that is drawn, world units."""
        ...


def fail(name: str, value: str, remedy: str) -> UsageError:
    """Return the error for a value of an operation."""
    return UsageError(f"{name}={value:.100}: {remedy}.")


def parse_number(name: str, value: str, low: float, high: float) -> float:
    """Return a number from `low` to `high`."""
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not low <= number <= high:
        raise fail(name, value, f"Give a number from {low:g} to {high:g}")
    return number


def parse_numbers(name: str, value: str, count: int) -> np.ndarray:
    """Return `count` numbers with commas between them, [count] float64."""
    parts = value.split(",")
    if len(parts) != count:
        raise fail(name, value, f"Give {count} numbers with commas between them")
    return np.array([parse_number(name, part, -1e30, 1e30) for part in parts])


def parse_volume(name: str, value: str, rig: VolumeRig) -> Volume:
    """Return a volume: a box, a sphere, an upright cylinder, or what a share of the cameras sees.

    Raises:
        UsageError: The value is not a volume. The error begins with the name.
    """
    kind, _, numbers = value.partition(":")
    if kind == "box":
        corners = parse_numbers(name, numbers, 6)
        if not (corners[:3] < corners[3:]).all():
            raise fail(name, value, "Give the low corner of the box first, then the high one")
        return Box(corners[:3], corners[3:])
    if kind == "sphere":
        found = parse_numbers(name, numbers, 4)
        _check_positive(name, value, found[3:])
        return Sphere(found[:3], float(found[3]))
    if kind == "cylinder":
        found = parse_numbers(name, numbers, 5)
        _check_positive(name, value, found[3:])
        return Cylinder(found[:3], rig.up / np.linalg.norm(rig.up), float(found[3]), float(found[4]))
    if kind == "capture":
        share = parse_number(name, numbers, 0, 1) if numbers else 0.5
        if not len(rig.cameras):
            raise fail(name, value, "There are no cameras here. Give a box, sphere or cylinder")
        return CaptureVolume(rig.cameras, rig.near, share)
    raise fail(name, value, f"Give {_VOLUMES}")


def _check_positive(name: str, value: str, sizes: np.ndarray) -> None:
    if not (sizes > 0).all():
        raise fail(name, value, "Give sizes above 0")
