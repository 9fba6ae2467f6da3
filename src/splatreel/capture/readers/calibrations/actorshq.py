"""Cameras of ActorsHQ (HumanRF): `calibration.csv` and `rgbs/Cam001/Cam001_rgb000000.jpg`, ...

A row has a `name`, the size `w`, `h` in pixels, a rotation vector `rx`, `ry`, `rz` and a translation `tx`, `ty`, `tz`
from the camera, in OpenCV's axes, to the world, in meters. `fx` and `px` are the focal length and the principal point as
multiples of the width, `fy` and `py` of the height. Images have no distortion. The center of the first pixel is at
(0.5, 0.5), as the export to COLMAP passes the principal point on.

Source: HumanRF (commit 4f0fc27), `actorshq/dataset/camera_data.py`, `actorshq/toolbox/export_colmap.py`.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from splatreel.base.errors import CaptureError
from splatreel.capture.readers.calibrations.calibrated_rig import (
    Rig,
    RigCamera,
    brown_lens,
    image_size,
    naming,
    pose,
    read_text,
)

COLUMNS = ("name", "w", "h", "rx", "ry", "rz", "tx", "ty", "tz", "fx", "fy", "px", "py")


def is_actorshq(file: Path, head: bytes) -> bool:
    """Return whether the start of a file is that of a calibration of ActorsHQ."""
    if file.suffix.lower() != ".csv":
        return False
    first = head.removeprefix(b"\xef\xbb\xbf").splitlines()[:1]
    return bool(first) and set(COLUMNS) <= {word.strip().decode("ascii", "replace") for word in first[0].split(b",")}


def read_actorshq(file: Path) -> Rig:
    """Return the cameras of a calibration.csv. Those without images are left out."""
    cameras = []
    for number, row in enumerate(csv.DictReader(read_text(file).splitlines(), skipinitialspace=True), 1):
        name = row.get("name")
        if not name:
            raise CaptureError(f"{file}: camera {number} has no name. Copy the file again.")
        whose = f"{file}: camera {name}"
        with naming(whose):
            size = image_size([float(row["w"]), float(row["h"])])
            values = {key: float(row[key]) for key in COLUMNS[3:]}
        if not np.isfinite([*values.values()]).all():
            raise CaptureError(f"{whose}: holds a number that is not finite: {values}. Copy the file again.")
        axes = Rotation.from_rotvec([values[key] for key in ("rx", "ry", "rz")]).as_matrix()
        center = np.array([values[key] for key in ("tx", "ty", "tz")])
        pinhole = [values[key] * side for key, side in zip(("fx", "fy", "px", "py"), size * 2, strict=True)]
        lens = brown_lens(whose, size, pinhole, [0.0] * 4, [0.0] * 2)
        cameras.append(RigCamera(name, pose(whose, axes.T, -axes.T @ center), size, lambda *_, lens=lens: lens))
    return Rig(file, cameras, partial=True)
