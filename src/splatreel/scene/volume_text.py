"""Volumes as users write them, such as `sphere:0,1,0,2`, and the numbers in them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from splatreel.base.errors import UsageError
from splatreel.scene.camera import Camera
from splatreel.scene.volumes import Box, CaptureVolume, Cylinder, Sphere, Volume

VOLUMES = (
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
    raise fail(name, value, f"Give {VOLUMES}")


def _check_positive(name: str, value: str, sizes: np.ndarray) -> None:
    if not (sizes > 0).all():
        raise fail(name, value, "Give sizes above 0")
