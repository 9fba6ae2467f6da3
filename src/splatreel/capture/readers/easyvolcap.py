"""EasyVolcap folders, the layout of ENeRF-Outdoor, MobileStage and others: `intri.yml`, `extri.yml` and images per camera.

Both files are OpenCV's. The first has `names` and per name `K` [3, 3], `D` or `dist` [5] (k1, k2, p1, p2, k3), `W` and
`H`. The second has `Rot` [3, 3] or `R` [3], a rotation vector, and `T` [3], world to camera. Images are in
`images/NAME/`, or there is `videos/NAME.mp4`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from splatreel.base.command_line import option, quoted
from splatreel.base.errors import CaptureError
from splatreel.capture.base import Request
from splatreel.capture.file_capture import FileCapture
from splatreel.capture.image_sequences import image_source
from splatreel.capture.lens import Lens, common_size, undistorted_camera
from splatreel.capture.pose_checks import check_center, check_rotation
from splatreel.capture.readers.calibrations.opencv import OpenCVStorage
from splatreel.capture.readers.colmap import images_by_camera, video_files
from splatreel.capture.readers.colmap_model import import_pycolmap
from splatreel.capture.sidecar import read_sidecar
from splatreel.capture.videos import video_source
from splatreel.scene.camera import middle_camera

INTRINSICS, EXTRINSICS = "intri.yml", "extri.yml"


def is_easyvolcap(path: Path) -> bool:
    """Return whether a folder is an EasyVolcap folder."""
    return (path / INTRINSICS).is_file() and (path / EXTRINSICS).is_file()


class EasyVolcapCapture(FileCapture):
    """EasyVolcap folder. By default a middle camera is held out."""

    def __init__(self, path: Path, request: Request) -> None:
        intrinsics, extrinsics = _Numbers(path / INTRINSICS), _Numbers(path / EXTRINSICS)
        names, sidecar = intrinsics.names(), read_sidecar(path)
        images, videos = images_by_camera(path / "images", names), video_files(path, segmented=True)
        kept = [name for name in names if name not in request.left_out]
        absent = [name for name in kept if name not in (images or videos)]
        if absent:
            raise CaptureError(
                f"{path}: {len(absent)} of the {len(names)} cameras in {INTRINSICS} have neither images in images/NAME/ nor a "
                f"video videos/NAME.mp4, the first is {absent[0]!r}. Copy them there, or leave cameras out "
                f"({quoted(option('--leave-out', ','.join(absent)))})."
            )
        if images:
            source = image_source(path, images, sidecar, request)
        else:
            source = video_source(path, {name: videos[name] for name in kept}, sidecar, request)
        calibrated = {name: intrinsics.size(name) or source.size(name if name in kept else kept[0]) for name in names}
        size = request.size(*common_size([source.size(name, calibrated[name]) for name in kept]), path)
        lenses: dict[str, Lens] = {}
        cameras = []
        for name in names:
            lens = _lens(intrinsics, name, calibrated[name])
            if intrinsics.size(name) is None and name in kept:
                remedy = f"Add W_{name} and H_{name}, the size for which K is"
                check_center(lens.calibration_matrix(), calibrated[name], f"{intrinsics.file}: K_{name}", remedy)
            camera, bent = undistorted_camera(
                name, _viewmat(extrinsics, name), lens, *size, f"{path / INTRINSICS}: camera {name}"
            )
            cameras.append(camera)
            if bent is not None:
                lenses[name] = bent
        held_out = [kept[middle_camera(request.kept(cameras, path))]] if sidecar.held_out is None else sidecar.held_out
        origin = path / EXTRINSICS
        super().__init__(
            path,
            cameras,
            source,
            request,
            held_out=held_out,
            lenses=lenses,
            origin=origin,
            calibrated=calibrated,
        )


class _Numbers:
    """File written by OpenCV. Raises `CaptureError` for other files."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self._storage = OpenCVStorage(file)
        if not self._storage.known:
            raise CaptureError(f"{file}: is not a YAML file of OpenCV's. Export the cameras again.")

    def names(self) -> list[str]:
        names = self._storage.strings("names")
        if not names:
            raise CaptureError(f"{self.file}: lists no cameras under `names`. Export the cameras again.")
        return names

    def array(self, name: str, shape: tuple[int, ...], *keys: str) -> np.ndarray | None:
        """Return the first existing KEY_NAME with a given shape, or None."""
        key = next((f"{key}_{name}" for key in keys if f"{key}_{name}" in self._storage.known), None)
        if key is None:
            return None
        value = self._storage.matrix(key)
        if value.size != np.prod(shape):
            raise CaptureError(
                f"{self.file}: {key} has {value.size} numbers, expected {np.prod(shape)}. Export the cameras again."
            )
        return value.reshape(shape)

    def needed(self, name: str, shape: tuple[int, ...], *keys: str) -> np.ndarray:
        value = self.array(name, shape, *keys)
        if value is None:
            raise CaptureError(
                f"{self.file}: has no {keys[0]}_{name}, though camera {name} is listed. Export the cameras again."
            )
        return value

    def size(self, name: str) -> tuple[int, int] | None:
        """Return width and height of a camera's images, or None if the file does not have them."""
        width, height = (int(self._storage.number(f"{key}_{name}") or 0) for key in ("W", "H"))
        return (width, height) if width > 0 and height > 0 else None


def _lens(intrinsics: _Numbers, name: str, size: tuple[int, int]) -> Any:
    K = intrinsics.needed(name, (3, 3), "K")
    bends = intrinsics.array(name, (5,), "D", "dist")
    if min(K[0, 0], K[1, 1]) <= 0 or abs(K[0, 1]) > 1e-2 * K[0, 0]:
        raise CaptureError(
            f"{intrinsics.file}: K_{name} is {K.tolist()}: focal lengths must be positive and the skew 0. Export the cameras again."
        )
    k1, k2, p1, p2, k3 = np.zeros(5) if bends is None else bends
    params = [K[0, 0], K[1, 1], K[0, 2], K[1, 2], k1, k2, p1, p2, k3, 0, 0, 0]
    return import_pycolmap().Camera(model="FULL_OPENCV", width=size[0], height=size[1], params=params)


def _viewmat(extrinsics: _Numbers, name: str) -> np.ndarray:
    matrix = extrinsics.array(name, (3, 3), "Rot")
    if matrix is None:
        matrix = Rotation.from_rotvec(extrinsics.needed(name, (3,), "R")).as_matrix()
    check_rotation(matrix, f"{extrinsics.file}: Rot_{name}")
    viewmat = np.eye(4)
    viewmat[:3, :3] = matrix
    viewmat[:3, 3] = extrinsics.needed(name, (3,), "T")
    return viewmat
