"""Lenses of a transforms.json."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from splatreel.base.errors import CaptureError
from splatreel.base.untrusted import is_number
from splatreel.capture.readers.calibrations.calibrated_rig import brown_lens, image_size, naming
from splatreel.capture.readers.colmap_model import import_pycolmap

PERSPECTIVE = ("", "PERSPECTIVE", "PINHOLE", "SIMPLE_PINHOLE", "RADIAL", "SIMPLE_RADIAL", "OPENCV")
FISHEYE = "OPENCV_FISHEYE"
OTHER = ("ftheta_p0", "latlong", "equirectangular", "orthographic")
"""Keys of instant-ngp for lenses that are not read."""


def transforms_lens(whose: str, values: dict[str, Any]) -> tuple[tuple[int, int] | None, Callable[[int, int], Any]]:
    """Return the image size, or None, and the function that makes the lens for the size of the images.

    Args:
        whose: Camera, for messages.
        values: Values of the file, replaced by those of the frame.
    """
    model = str(values.get("camera_model", "")).upper()
    if values.get("is_fisheye"):
        model = FISHEYE
    other = [key for key in OTHER if values.get(key)]
    if other or model not in (*PERSPECTIVE, FISHEYE):
        raise CaptureError(
            f"{whose}: has the lens {other[0] if other else model}, which is not read. Read are perspective and {FISHEYE}: undistort "
            f"the images first."
        )
    with naming(whose):
        size = image_size([_number(values, "w"), _number(values, "h")]) if "w" in values and "h" in values else None
        listed = values.get("distortion_params")
        k1, k2, k3, k4, p1, p2 = (
            [_number(values, key) for key in ("k1", "k2", "k3", "k4", "p1", "p2")]
            if listed is None
            else [float(value) for value in listed]
        )
    if model == FISHEYE and (p1 or p2):
        raise CaptureError(f"{whose}: is a fisheye with p1 {p1:g} and p2 {p2:g}, which {FISHEYE} lacks. Set them to 0.")

    def lens(width: int, height: int) -> Any:
        width, height = size or (width, height)
        with naming(whose):
            fx, fy = _focal_lengths(values, width, height)
            pinhole = [fx, fy, _number(values, "cx", width / 2), _number(values, "cy", height / 2)]
        if model != FISHEYE:
            return brown_lens(whose, (width, height), pinhole, [k1, k2, k3, k4], [p1, p2])
        return import_pycolmap().Camera(model=FISHEYE, width=width, height=height, params=[*pinhole, k1, k2, k3, k4])

    return size, lens


def _focal_lengths(values: dict[str, Any], width: int, height: int) -> tuple[float, float]:
    """Return both focal lengths in pixels. One of them is used for both where the other is missing."""
    found = []
    for axis, side in (("x", width), ("y", height)):
        if f"fl_{axis}" in values:
            found.append(_number(values, f"fl_{axis}"))
        elif f"camera_angle_{axis}" in values:
            found.append(side / 2 / math.tan(_number(values, f"camera_angle_{axis}") / 2))
        elif f"{axis}_fov" in values:
            found.append(side / 2 / math.tan(math.radians(_number(values, f"{axis}_fov")) / 2))
        else:
            found.append(0.0)
    fx, fy = found[0] or found[1], found[1] or found[0]
    if min(fx, fy) <= 0:
        raise ValueError("it has no positive focal length fl_x, nor a camera_angle_x")
    return fx, fy


def _number(values: dict[str, Any], key: str, default: float = 0.0) -> float:
    value = values.get(key, default)
    if not is_number(value):
        raise ValueError(f"{key} is {value!r:.40}, not a number")
    return float(value)
