"""Values of operations: axes, colors and ranges of frames."""

from __future__ import annotations

import re

import numpy as np

from splatreel.edit.clip import Outline
from splatreel.scene.volume_text import fail, parse_number, parse_numbers


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
    if re.fullmatch("[0-9]{1,15}", text) is None:
        raise fail(name, text, "Give a whole number of frames, or seconds like 1.5s")
    return int(text)
