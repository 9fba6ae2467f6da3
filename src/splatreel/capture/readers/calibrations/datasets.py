"""Calibrations of published data sets: ActorsHQ, Google's immersive videos, CMU Panoptic Studio and ZJU-MoCap."""

from __future__ import annotations

import csv
import io
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from splatreel.base.errors import CaptureError
from splatreel.base.untrusted import load_arrays, numbers, read_file, read_json
from splatreel.capture.readers.calibrations.calibrated_rig import (
    CALIBRATION_BYTES,
    Rig,
    RigCamera,
    brown_lens,
    image_size,
    naming,
    opencv_lens,
    pose,
    read_text,
)
from splatreel.capture.readers.colmap_model import import_pycolmap

COLUMNS = ("name", "w", "h", "rx", "ry", "rz", "tx", "ty", "tz", "fx", "fy", "px", "py")


def is_actorshq(file: Path, head: bytes) -> bool:
    """Return whether the start of a file is that of a calibration of ActorsHQ."""
    if file.suffix.lower() != ".csv":
        return False
    first = head.removeprefix(b"\xef\xbb\xbf").splitlines()[:1]
    return bool(first) and set(COLUMNS) <= {word.strip().decode("ascii", "replace") for word in first[0].split(b",")}


def read_actorshq(file: Path) -> Rig:
    """Return the cameras of a calibration.csv. Those without images are left out.

    Cameras of ActorsHQ (HumanRF): `calibration.csv` and `rgbs/Cam001/Cam001_rgb000000.jpg`, ...

    A row has a `name`, the size `w`, `h` in pixels, a rotation vector `rx`, `ry`, `rz` and a translation `tx`, `ty`, `tz`
    from the camera, in OpenCV's axes, to the world, in meters. `fx` and `px` are the focal length and the principal point as
    multiples of the width, `fy` and `py` of the height. Images have no distortion. The center of the first pixel is at
    (0.5, 0.5), as the export to COLMAP passes the principal point on.

    Source: HumanRF (commit 4f0fc27), `actorshq/dataset/camera_data.py`, `actorshq/toolbox/export_colmap.py`.
    """
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


KEYS = (b'"orientation"', b'"position"', b'"principal_point"', b'"radial_distortion"')
FISHEYE = "fisheye"
COEFFICIENTS = 2
"""Number of radial coefficients that are known."""


def is_immersive(file: Path, head: bytes) -> bool:
    """Return whether the start of a file is that of Google's list of cameras."""
    return file.suffix.lower() == ".json" and head.lstrip().startswith(b"[") and all(key in head for key in KEYS)


def read_immersive(file: Path) -> Rig:
    """Return the cameras of a models.json.

    Cameras of Google's immersive light field videos (DeepView video): `models.json` and `camera_0001.mp4`, ...

    A camera has a `name`, `width`, `height`, one `focal_length` in pixels for x, which times `pixel_aspect_ratio` is that
    for y, a `principal_point` in pixels, and a `position`. `orientation` is a rotation vector from the world to the camera,
    in OpenCV's axes. The projection is a fisheye: an angle t off the axis is seen at t (1 + k1 t^2 + k2 t^4) focal lengths,
    with k1 and k2 from `radial_distortion`, whose third number is 0. The center of the first pixel is at (0.5, 0.5).

    Source: `pre_immersive_distorted.py` of SpacetimeGaussians (commit 17307ec) and `datasets/immersive.py` of HyperReel
    (commit ba1cc5c), which agree; pixel centers of Nerfies' cameras, which have the same fields.
    """
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


def is_panoptic_studio(file: Path, head: bytes) -> bool:
    """Return whether the start of a file is that of a Panoptic Studio calibration."""
    return file.suffix.lower() == ".json" and all(key in head for key in (b'"panel"', b'"node"', b'"distCoef"'))


def read_panoptic_studio(file: Path) -> Rig:
    """Return the HD cameras.

    Calibrations of the CMU Panoptic Studio: `calibration_SEQUENCE.json` beside `hdVideos/` or `hdImgs/`.

    A camera has `name` (panel and node), `type`, `resolution`, `K` [3, 3], `distCoef` (k1, k2, p1, p2, k3), `R` [3, 3] and `t`
    [3], world to camera, in centimeters. The toolbox projects as cv2.projectPoints does, so the center of the first pixel is
    at (0, 0). The 31 HD cameras are read. Their videos are `hd_00_05.mp4`, and `00_05/00_05_00000000.jpg` their images. VGA
    and Kinect cameras have other times and are not read.

    Source: panoptic-toolbox (commit 246ebcf), `README.md`, `python/panutils.py`, `scripts/hdImgsExtractor.sh`.
    """
    content = read_json(file, CaptureError)
    with naming(str(file)):
        found = [entry for entry in content["cameras"] if entry["type"] == "hd"]
    cameras = []
    for entry in found:
        whose = f"{file}: camera {entry.get('name')}"
        with naming(whose):
            name, size = str(entry["name"]), image_size(entry["resolution"])
            lens = opencv_lens(whose, entry["K"], entry["distCoef"], size)
            viewmat = pose(whose, entry["R"], entry["t"])
        cameras.append(RigCamera(name, viewmat, size, lambda *_, lens=lens: lens))
    if not cameras:
        raise CaptureError(f"{file}: holds no HD cameras, which are the ones that are read.")
    return Rig(file, cameras, partial=True)


NAME = "annots.npy"
MILLIMETERS = 1000.0
HEADER = 10_000
"""Maximum size of the array header in bytes."""


def is_zju_mocap(file: Path, head: bytes) -> bool:
    """Return whether a file is the list of cameras of ZJU-MoCap."""
    return file.name == NAME and head.startswith(np.lib.format.MAGIC_PREFIX) and b"|O" in head[:256]


def read_zju_mocap(file: Path) -> Rig:
    """Return the cameras of an annots.npy.

    Cameras of ZJU-MoCap (Neural Body): `annots.npy` and a folder of images per camera, such as `Camera_B1/000000.jpg`.

    The file is a pickled dictionary. `cams` has lists by camera: `K` [3, 3], `D` [5] in OpenCV's order, `R` [3, 3] and `T`
    [3] from the world to the camera, in millimeters. `ims` lists the images of each frame in the order of these cameras.
    Translations become meters. cv2 undistorts the images, so the center of the first pixel is at (0, 0).

    Source: Neural Body (zju3dv/neuralbody), `lib/datasets/light_stage/multi_view_dataset.py` (`T` is divided by 1000,
    `cv2.undistort`), and `INSTALL.md` for the layout.
    """
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
