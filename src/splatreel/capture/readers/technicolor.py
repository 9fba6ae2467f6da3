"""Undistorted Technicolor light-field videos (Sabater et al. 2017): `SCENE_undist_FRAME_CAMERA.png` and `cameras_parameters.txt`.

After a header line there is a line per camera: focal length, principal point (2), aspect ratio, skew, rotation
quaternion wxyz and translation, world to camera.
"""

from __future__ import annotations

import re
from collections import defaultdict
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from splatreel.base.errors import CaptureError
from splatreel.base.untrusted import read_file
from splatreel.capture.base import Request
from splatreel.capture.file_capture import FileCapture
from splatreel.capture.image_sequences import image_files, image_source
from splatreel.capture.lens import common_size, fitted_camera
from splatreel.capture.pose_checks import check_center
from splatreel.capture.sidecar import read_sidecar
from splatreel.scene.camera import Camera

PARAMETER_BYTES = 1 << 20
PARAMETERS = "cameras_parameters.txt"
HELD_OUT = "10"
"""Middle camera of the rig, used in published tables (paper, appendix B)."""
NUMBERS = 12
IMAGE = re.compile(r".+_undist_(\d+)_(\d+)")


def is_technicolor(path: Path) -> bool:
    """Return whether a folder is a Technicolor folder."""
    return (path / PARAMETERS).is_file()


class TechnicolorCapture(FileCapture):
    """Technicolor folder. Cameras are named by their two digits, and 10 is held out by default."""

    def __init__(self, path: Path, request: Request) -> None:
        sidecar, files = read_sidecar(path), _images(path)
        rows = _read_parameters(path / PARAMETERS)
        if sorted(int(name) for name in files) != list(range(len(rows))):
            raise CaptureError(
                f"{path}: images of the cameras {', '.join(sorted(files)) or 'none'} (SCENE_undist_FRAME_CAMERA.png), but "
                f"{len(rows)} lines of cameras in {PARAMETERS}. They belong together in their order, from 00 on: add what is missing."
            )
        images = image_source(path, files, sidecar, request)
        names = sorted(files)
        default = sidecar.held_out if sidecar.held_out is not None else [name for name in names if name == HELD_OUT]
        sizes = {name: images.size(name) for name in names if name not in request.left_out}
        usual = common_size(list(sizes.values()))
        size = request.size(*usual, path)
        fitted = {
            name: fitted_camera(_camera(name, row, *sizes.get(name, usual)), *size)
            for name, row in zip(names, rows, strict=True)
        }
        super().__init__(
            path,
            [camera for camera, _ in fitted.values()],
            images,
            request,
            held_out=default,
            lenses={name: lens for name, (_, lens) in fitted.items() if lens is not None},
            calibrated=sizes,
            origin=path / PARAMETERS,
        )


def _camera(name: str, row: np.ndarray, width: int, height: int) -> Camera:
    viewmat = np.eye(4)
    viewmat[:3, :3] = Rotation.from_quat(row[[6, 7, 8, 5]]).as_matrix()
    viewmat[:3, 3] = row[9:12]
    K = np.array([[row[0], 0, row[1]], [0, row[0], row[2]], [0, 0, 1]])
    check_center(K, (width, height), f"{PARAMETERS}: camera {name}", "Copy the images for which the parameters are")
    return Camera(name, viewmat, K, width, height)


def _images(path: Path) -> dict[str, list[Path]]:
    found: dict[str, list[Path]] = defaultdict(list)
    for file in image_files(path):
        if match := IMAGE.fullmatch(file.stem):
            found[match[2]].append(file)
    return found


def _read_parameters(file: Path) -> np.ndarray:
    """Return the checked parameters, [cameras, 12]."""
    data = read_file(file, PARAMETER_BYTES, CaptureError)
    try:
        rows = [np.array(line.split(), np.float64) for line in data.decode("utf-8").splitlines()[1:] if line.strip()]
    except ValueError as error:
        raise CaptureError(
            f"{file}: cannot be read ({error}). After a line of titles it has a line of numbers a camera."
        ) from error
    for number, row in enumerate(rows):
        if row.shape != (NUMBERS,):
            raise CaptureError(
                f"{file}: camera {number} has {row.size} numbers, expected {NUMBERS}. Only undistorted images are read, and they "
                f"have: focal length, principal point, aspect ratio, skew, quaternion wxyz, translation."
            )
        focal, aspect, skew, turn = row[0], row[3], row[4], np.linalg.norm(row[5:9])
        if not (
            np.isfinite(row).all()
            and focal > 0
            and abs(turn - 1) < 1e-2
            and abs(aspect - 1) < 1e-2
            and abs(skew) < 1e-2 * focal
        ):
            raise CaptureError(
                f"{file}: camera {number} is {row.tolist()}: its focal length must be positive, its aspect ratio 1, its skew 0 and "
                f"its quaternion of length 1. Copy the file again."
            )
    return np.array(rows).reshape(-1, NUMBERS)
