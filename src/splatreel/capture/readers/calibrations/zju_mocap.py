"""Cameras of ZJU-MoCap (Neural Body): `annots.npy` and a folder of images per camera, such as `Camera_B1/000000.jpg`.

The file is a pickled dictionary. `cams` has lists by camera: `K` [3, 3], `D` [5] in OpenCV's order, `R` [3, 3] and `T`
[3] from the world to the camera, in millimeters. `ims` lists the images of each frame in the order of these cameras.
Translations become meters. cv2 undistorts the images, so the center of the first pixel is at (0, 0).

Source: Neural Body (zju3dv/neuralbody), `lib/datasets/light_stage/multi_view_dataset.py` (`T` is divided by 1000,
`cv2.undistort`), and `INSTALL.md` for the layout.
"""

from __future__ import annotations

import io
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from splatreel.base.errors import CaptureError
from splatreel.base.untrusted import load_arrays, read_file
from splatreel.capture.readers.calibrations.calibrated_rig import (
    CALIBRATION_BYTES,
    Rig,
    RigCamera,
    naming,
    opencv_lens,
    pose,
)

NAME = "annots.npy"
MILLIMETERS = 1000.0
HEADER = 10_000
"""Maximum size of the array header in bytes."""


def is_zju_mocap(file: Path, head: bytes) -> bool:
    """Return whether a file is the list of cameras of ZJU-MoCap."""
    return file.name == NAME and head.startswith(np.lib.format.MAGIC_PREFIX) and b"|O" in head[:256]


def read_zju_mocap(file: Path) -> Rig:
    """Return the cameras of an annots.npy."""
    content = _content(file)
    with naming(str(file)):
        cams, first = content["cams"], list(content["ims"][0]["ims"])
        names = [_folder(str(path)) for path in first]
        lists = {key: list(cams[key]) for key in ("K", "D", "R", "T")}
        counts = {key: len(values) for key, values in lists.items()}
        if min(counts.values()) < len(names):
            raise ValueError(f"its lists have {counts} entries for the {len(names)} cameras of the first frame")
    cameras = []
    for c, name in enumerate(names):
        whose = f"{file}: camera {name}"
        K, D, R, T = (lists[key][c] for key in ("K", "D", "R", "T"))
        with naming(whose):
            viewmat = pose(whose, R, np.asarray(T, np.float64) / MILLIMETERS)
        cameras.append(RigCamera(name, viewmat, None, lambda *size, w=whose, K=K, D=D: opencv_lens(w, K, D, size)))
    return Rig(file, cameras, partial=True)


def _folder(path: str) -> str:
    """Return the folder of an image, which is named as its camera."""
    return PurePosixPath(path.replace("\\", "/")).parent.name


def _content(file: Path) -> dict[str, Any]:
    """Return the dictionary in the file. Nothing but numbers, strings and containers is built."""
    data = io.BytesIO(read_file(file, CALIBRATION_BYTES, CaptureError))
    try:
        version = np.lib.format.read_magic(data)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        read(data, HEADER)
        value = load_arrays(data)
        found = value.item() if isinstance(value, np.ndarray) and value.size == 1 else value
    except Exception as error:  # a damaged pickle may raise any exception
        raise CaptureError(f"{file}: cannot be read ({error}). Copy it again from the data set.") from error
    if not isinstance(found, dict):
        raise CaptureError(f"{file}: holds no dictionary of cameras. Copy it again from the data set.")
    return found
