"""Values of operations: numbers, axes, colors, volumes and ranges of frames."""

from __future__ import annotations

import math
import re

import numpy as np

from splatreel.codec.header import ReelHeader
from splatreel.edit.clip import Outline
from splatreel.errors import UsageError
from splatreel.scene.volumes import Box, CaptureVolume, Cylinder, Sphere, Volume

VOLUMES = (
    "box:x,y,z,X,Y,Z, sphere:x,y,z,RADIUS, cylinder:x,y,z,RADIUS,HEIGHT (x,y,z is the middle of its base) or capture"
)


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


def parse_axis(name: str, value: str) -> np.ndarray:
    """Return a unit direction [3]: x, -x, y, -y, z, -z or three numbers."""
    match = re.fullmatch("(-?)([xyz])", value.strip())
    direction = np.zeros(3)
    if match:
        direction["xyz".index(match[2])] = -1.0 if match[1] else 1.0
        return direction
    if value.count(",") != 2:
        raise fail(name, value, "Give x, -x, y, -y, z, -z or three numbers as the axis")
    direction = parse_numbers(name, value, 3)
    length = float(np.linalg.norm(direction))
    if length < 1e-12:
        raise fail(name, value, "Give an axis that is not zero")
    return direction / length


def parse_color(name: str, value: str) -> np.ndarray:
    """Return a color `#rrggbb` as [3], 0..1."""
    match = re.fullmatch("#?([0-9a-fA-F]{6})", value)
    if match is None:
        raise fail(name, value, "Give a color like #ffffff")
    return np.array([int(match[1][i : i + 2], 16) for i in (0, 2, 4)]) / 255


def parse_range(name: str, value: str, outline: Outline) -> tuple[int, int]:
    """Return the first frame and the frame after the last of `A:B`, in frames or, with an s, in seconds."""
    match = re.fullmatch(r"([0-9.]+s?)?:([0-9.]+s?)?", value)
    if match is None or not (match[1] or match[2]):
        raise fail(name, value, "Give a range A:B of frames, or of seconds like 1.5s:4s")
    fps, first, end = outline.header.fps, match[1], match[2]
    ends = _frame(name, first, fps) if first else 0, _frame(name, end, fps) if end else outline.frames
    if not 0 <= ends[0] < ends[1] <= outline.frames:
        raise fail(name, value, f"Choose frames from 0:{outline.frames}, which are {outline.seconds:g} seconds")
    return ends[0], ends[1]


def _frame(name: str, text: str, fps: float) -> int:
    if text.endswith("s"):
        return round(parse_number(name, text[:-1], 0, 1e7) * fps)
    if not text.isdigit():
        raise fail(name, text, "Give a whole number of frames, or seconds like 1.5s")
    return int(text)


def parse_volume(name: str, value: str, header: ReelHeader) -> Volume:
    """Return a volume: a box, a sphere, an upright cylinder, or what a share of the cameras sees."""
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
        return Cylinder(found[:3], header.up / np.linalg.norm(header.up), float(found[3]), float(found[4]))
    if kind == "capture":
        share = parse_number(name, numbers, 0, 1) if numbers else 0.5
        if not header.cameras:
            raise fail(name, value, "This reel has no cameras. Give a box, sphere or cylinder")
        return CaptureVolume(header.cameras, header.near, share)
    raise fail(name, value, f"Give {VOLUMES}")


def _check_positive(name: str, value: str, sizes: np.ndarray) -> None:
    if not (sizes > 0).all():
        raise fail(name, value, "Give sizes above 0")
