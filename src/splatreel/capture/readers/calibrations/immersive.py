"""Cameras of Google's immersive light field videos (DeepView video): `models.json` and `camera_0001.mp4`, ...

A camera has a `name`, `width`, `height`, one `focal_length` in pixels for x, which times `pixel_aspect_ratio` is that
for y, a `principal_point` in pixels, and a `position`. `orientation` is a rotation vector from the world to the camera,
in OpenCV's axes. The projection is a fisheye: an angle t off the axis is seen at t (1 + k1 t^2 + k2 t^4) focal lengths,
with k1 and k2 from `radial_distortion`, whose third number is 0. The center of the first pixel is at (0.5, 0.5).

Source: `pre_immersive_distorted.py` of SpacetimeGaussians (commit 17307ec) and `datasets/immersive.py` of HyperReel
(commit ba1cc5c), which agree; pixel centers of Nerfies' cameras, which have the same fields.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from splatreel.base.errors import CaptureError
from splatreel.base.untrusted import numbers, read_json
from splatreel.capture.readers.calibrations.calibrated_rig import Rig, RigCamera, image_size, naming, pose
from splatreel.capture.readers.colmap_model import import_pycolmap

KEYS = (b'"orientation"', b'"position"', b'"principal_point"', b'"radial_distortion"')
FISHEYE = "fisheye"
COEFFICIENTS = 2
"""Number of radial coefficients that are known."""


def is_immersive(file: Path, head: bytes) -> bool:
    """Return whether the start of a file is that of Google's list of cameras."""
    return file.suffix.lower() == ".json" and head.lstrip().startswith(b"[") and all(key in head for key in KEYS)


def read_immersive(file: Path) -> Rig:
    """Return the cameras of a models.json."""
    cameras = []
    with naming(str(file)):
        entries = list(read_json(file, CaptureError))
    for entry in entries:
        with naming(f"{file}: a camera"):
            name = str(entry["name"])
        whose = f"{file}: camera {name}"
        with naming(whose):
            kind, size = entry.get("projection_type", FISHEYE), image_size([entry["width"], entry["height"]])
            aspect = entry.get("pixel_aspect_ratio", 1)
            (focal, stretch), center = numbers([entry["focal_length"], aspect], 2), numbers(entry["principal_point"], 2)
            bends = numbers(entry["radial_distortion"], len(entry["radial_distortion"]))
            place, turn = numbers(entry["position"], 3), numbers(entry["orientation"], 3)
        if kind != FISHEYE or min(focal, stretch) <= 0 or np.any(bends[COEFFICIENTS:]):
            raise CaptureError(
                f"{whose}: is {kind!r:.40} with focal length {focal:g}, pixel aspect ratio {stretch:g} and radial distortion "
                f"{bends.tolist()}. Read are fisheyes with positive focal lengths and {COEFFICIENTS} coefficients: "
                f"undistort the videos first, and describe them by a transforms.json."
            )
        k = np.pad(bends[:COEFFICIENTS], (0, 4 - len(bends[:COEFFICIENTS]))).tolist()
        params = [focal, focal * stretch, *center.tolist(), *k]
        lens = import_pycolmap().Camera(model="OPENCV_FISHEYE", width=size[0], height=size[1], params=params)
        rotation = Rotation.from_rotvec(turn).as_matrix()
        viewmat = pose(whose, rotation, -rotation @ place)
        cameras.append(RigCamera(name, viewmat, size, lambda *_, lens=lens: lens))
    return Rig(file, cameras, partial=True)
