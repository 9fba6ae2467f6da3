"""Calibrations of motion capture: TOML as Anipose, FreeMoCap, Pose2Sim and Caliscope write it, and Qualisys."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from splatreel.base.errors import CaptureError
from splatreel.capture.readers.calibrations.calibrated_rig import (
    OPENCV_CENTER,
    Rig,
    RigCamera,
    image_size,
    naming,
    opencv_lens,
    pose,
    read_text,
    read_xml,
)

KEYS = (rb"(?m)^[ \t]*matrix[ \t]*=", rb"(?m)^[ \t]*translation[ \t]*=", rb"(?m)^[ \t]*size[ \t]*=")

DEEPEST = 16
"""Maximum number of dots in a key. The parser takes quadratic time for long ones."""
_PART = r"""(?:"[^"\n]*+"|'[^'\n]*+'|[\w-]++)"""
_DEEP_KEY = re.compile(rf"(?<![\w-])(?:{_PART}[ \t]*+\.[ \t]*+){{{DEEPEST + 1}}}")


def is_toml(file: Path, head: bytes) -> bool:
    """Return whether the start of a file is that of a calibration in TOML."""
    return file.suffix.lower() == ".toml" and all(re.search(key, head) for key in KEYS)


def read_toml(file: Path) -> Rig:
    """Return the cameras of a TOML file. Cameras without a pose are left out.

    Calibrations in TOML: aniposelib, Anipose, FreeMoCap, Pose2Sim and Caliscope.

    A table per camera has `size` [width, height], `matrix` [3, 3], `distortions` in OpenCV's order, `rotation` (a rotation
    vector, or [3, 3]) and `translation`, both from the world to the camera. `fisheye = true` means `cv2.fisheye`. Anipose,
    FreeMoCap and Pose2Sim write the tables at the top, with a `name`; Caliscope writes `cameras.N`. All use cv2, so the
    center of the first pixel is at (0, 0). Units differ: meters in Pose2Sim and Caliscope, millimeters in FreeMoCap.

    Source: `aniposelib/cameras.py` (commit 1fa3b62), Pose2Sim's `calibration.py` (`toml_write`, commit f7b39c7), Caliscope's
    `cameras/camera_array.py` (`CameraArray.from_toml`, commit ddda95b).
    """
    text = read_text(file)
    if _DEEP_KEY.search(text) is not None:
        raise CaptureError(f"{file}: has a key with more than {DEEPEST} dots. Export the calibration again.")
    try:
        content = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # also integers of thousands of digits
        raise CaptureError(f"{file}: is not a TOML file ({error}). Export the calibration again.") from error
    nested = content.get("cameras")
    tables = {f"cam_{key}": table for key, table in nested.items()} if isinstance(nested, dict) else content
    found = {key: table for key, table in tables.items() if isinstance(table, dict) and "matrix" in table}
    cameras, unposed = [], []
    for key, table in found.items():
        if table.get("ignore") is True:
            continue
        if "rotation" not in table or "translation" not in table:
            unposed.append(key)
            continue
        cameras.append(_toml_camera(file, key, table))
    notes = [f"{file}: {', '.join(unposed)} without a pose were left out"] if unposed else []
    return Rig(file, cameras, notes=notes)


def _toml_camera(file: Path, key: str, table: dict[str, Any]) -> RigCamera:
    name = table.get("name", key)
    whose = f"{file}: camera {name}"
    with naming(whose):
        size = image_size(table["size"])
        matrix, distortions = table["matrix"], table["distortions"]
    lens = opencv_lens(whose, matrix, distortions, size, table.get("fisheye") is True)
    return RigCamera(str(name), pose(whose, table["rotation"], table["translation"]), size, lambda *_: lens)


SUBPIXELS = 64
VIDEO_MODELS = ("video", "hybrid", "none")
"""Parts of the names of models that film. Other models see only markers."""


def is_qualisys(file: Path, head: bytes) -> bool:
    """Return whether the start of a file is that of a Qualisys calibration."""
    return file.suffix.lower() in (".txt", ".xml") and b"<calibration" in head and b"focalLengthU" in head


def read_qualisys(file: Path) -> Rig:
    """Return the cameras of a Qualisys calibration that film.

    Calibrations of Qualisys Track Manager: `NAME.qca.txt`, an XML file.

    A camera has its `serial`, a field of view `fov_video` in pixels, `intrinsic` in 64ths of a pixel, and `transform` in
    millimeters. r11, r12, r13 are the camera's x axis in the world, r21 ... its y axis, which points up, and r31 ... its z
    axis, which points backwards. x, y, z is the position. Distortion coefficients have no unit and are in OpenCV's order.
    Lengths become meters.

    Source: Pose2Sim's `calibration.py` (`read_qca`, commit f7b39c7) and its demo file, for all but the distortion: Pose2Sim
    divides it by 64, whereas the values in files of Miqus and Oqus cameras (-0.05 to -0.15) only make sense undivided.
    """
    cameras = []
    for node in read_xml(file).iterfind("cameras/camera"):
        if any(word in node.get("model", "none").lower() for word in VIDEO_MODELS):
            cameras.append(_qualisys_camera(file, node))
    if not cameras:
        raise CaptureError(f"{file}: holds no camera that films. Export the calibration of the video cameras.")
    return Rig(file, cameras)


def _qualisys_camera(file: Path, node: Element) -> RigCamera:
    with naming(f"{file}: a camera"):
        name = node.attrib["serial"]
    whose = f"{file}: camera {name}"
    with naming(whose):
        if float(node.get("viewrotation", "0")) % 360:
            raise CaptureError(
                f"{whose}: its view is turned by {node.get('viewrotation')} degrees. Calibrate with viewrotation 0 and unturned videos."
            )
        view, lens, place = (_part(node, tag) for tag in ("fov_video", "intrinsic", "transform"))
        left, top = float(view["left"]), float(view["top"])
        size = image_size([float(view["right"]) - left + 1, float(view["bottom"]) - top + 1])
        fx, fy, cx, cy = (
            float(lens[key]) / SUBPIXELS for key in ("focalLengthU", "focalLengthV", "centerPointU", "centerPointV")
        )
        # Position 0 is the first subpixel, half a subpixel inside of the image.
        inside = 0.5 / SUBPIXELS - OPENCV_CENTER
        K = [[fx, float(lens["skew"]) / SUBPIXELS, cx - left + inside], [0, fy, cy - top + inside], [0, 0, 1]]
        bends = [
            float(lens[key])
            for key in (
                "radialDistortion1",
                "radialDistortion2",
                "tangentalDistortion1",
                "tangentalDistortion2",
                "radialDistortion3",
            )
        ]
        axes = np.array([[float(place[f"r{row}{column}"]) for column in (1, 2, 3)] for row in (1, 2, 3)])
        center = np.array([float(place[axis]) for axis in "xyz"]) / 1000
    camera = opencv_lens(whose, K, bends, size)
    rotation = np.diag([1.0, -1, -1]) @ axes
    return RigCamera(name, pose(whose, rotation, -rotation @ center), size, lambda *_: camera)


def _part(node: Element, tag: str) -> dict[str, str]:
    found = node.find(tag)
    if found is None:
        raise KeyError(tag)
    return found.attrib
