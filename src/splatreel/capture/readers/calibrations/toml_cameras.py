"""Calibrations in TOML: aniposelib, Anipose, FreeMoCap, Pose2Sim and Caliscope.

A table per camera has `size` [width, height], `matrix` [3, 3], `distortions` in OpenCV's order, `rotation` (a rotation
vector, or [3, 3]) and `translation`, both from the world to the camera. `fisheye = true` means `cv2.fisheye`. Anipose,
FreeMoCap and Pose2Sim write the tables at the top, with a `name`; Caliscope writes `cameras.N`. All use cv2, so the
center of the first pixel is at (0, 0). Units differ: meters in Pose2Sim and Caliscope, millimeters in FreeMoCap.

Source: `aniposelib/cameras.py` (commit 1fa3b62), Pose2Sim's `calibration.py` (`toml_write`, commit f7b39c7), Caliscope's
`cameras/camera_array.py` (`CameraArray.from_toml`, commit ddda95b).
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from splatreel.base.errors import CaptureError
from splatreel.capture.readers.calibrations.calibrated_rig import (
    Rig,
    RigCamera,
    image_size,
    naming,
    opencv_lens,
    pose,
    read_text,
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
    """Return the cameras of a TOML file. Cameras without a pose are left out."""
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
        cameras.append(_camera(file, key, table))
    notes = [f"{file}: {', '.join(unposed)} without a pose were left out"] if unposed else []
    return Rig(file, cameras, notes=notes)


def _camera(file: Path, key: str, table: dict[str, Any]) -> RigCamera:
    name = table.get("name", key)
    whose = f"{file}: camera {name}"
    with naming(whose):
        size = image_size(table["size"])
        matrix, distortions = table["matrix"], table["distortions"]
    lens = opencv_lens(whose, matrix, distortions, size, table.get("fisheye") is True)
    return RigCamera(str(name), pose(whose, table["rotation"], table["translation"]), size, lambda *_: lens)
