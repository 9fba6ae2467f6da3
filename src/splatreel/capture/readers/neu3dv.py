"""Neural 3D Video folders: one `camNN.mp4`, or a folder of images, per camera and `poses_bounds.npy` (LLFF).

A row of poses_bounds is a 3x5 matrix, then near and far. The matrix holds camera-to-world axes in the order (down,
right, backwards), the camera center, and (height, width, focal). The principal point is the image center. An optional
`splatreel.json` adds more (`capture/sidecar.py`).
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from splatreel.base.command_line import quoted
from splatreel.base.errors import CaptureError
from splatreel.base.untrusted import read_array
from splatreel.capture.base import Request
from splatreel.capture.file_capture import FileCapture
from splatreel.capture.files import natural_key
from splatreel.capture.image_sequences import flat_images, image_source
from splatreel.capture.lens import common_size, fitted_camera
from splatreel.capture.pose_checks import check_rotation
from splatreel.capture.readers.calibrated import is_calibrated
from splatreel.capture.readers.colmap import camera_folders, is_colmap, video_files, videos_in
from splatreel.capture.readers.transforms import is_transforms
from splatreel.capture.sidecar import calibration_error, read_sidecar
from splatreel.capture.videos import video_source
from splatreel.scene.camera import Camera

POSES = "poses_bounds.npy"
EXPECTED = "3x5 pose, near and far in a row"
HELD_OUT = re.compile("cam_?0+")
"""Camera numbered 0: `cam00`, in MeetRoom `cam_0`."""


def is_neu3dv(path: Path) -> bool:
    """Return whether a folder is a Neu3DV folder."""
    others = (is_colmap, is_transforms, is_calibrated)
    return (path / POSES).is_file() or (bool(_cameras_of(videos_in(path))) and not any(fits(path) for fits in others))


class Neu3DVCapture(FileCapture):
    """Neu3DV folder with videos, or with images as in CAMERA/images/0000.png. By default the camera numbered 0 is held out."""

    def __init__(self, path: Path, request: Request) -> None:
        sidecar, poses, notes = read_sidecar(path), _read_poses(path / POSES), list[str]()
        videos, images = _videos(path), _cameras_of(camera_folders(path))
        names = _names(path, list(videos or images), len(poses), request, notes)
        kept = [name for name in names if name not in request.left_out]
        if videos:
            source = video_source(path, {name: videos[name] for name in kept}, sidecar, request)
        else:
            source = image_source(path, {name: images[name] for name in kept}, sidecar, request)
        calibrated = {name: (round(row[9]), round(row[4])) for name, row in zip(names, poses, strict=True)}
        sizes = {name: source.size(name, calibrated[name]) for name in kept}
        usual = common_size(list(sizes.values()))
        size = request.size(*usual, path)
        fitted = {
            name: fitted_camera(_camera(path, name, sizes.get(name, usual), row), *size)
            for name, row in zip(names, poses, strict=True)
        }
        default = sidecar.held_out if sidecar.held_out is not None else [n for n in names if HELD_OUT.fullmatch(n)]
        super().__init__(
            path,
            [camera for camera, _ in fitted.values()],
            source,
            replace(request, left_out=request.left_out & set(names)),
            held_out=default,
            lenses={name: lens for name, (_, lens) in fitted.items() if lens is not None},
            near=float(poses[:, 15].min()),
            origin=path / POSES,
            notes=notes,
            calibrated=calibrated,
        )


def _cameras_of(found: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in found.items() if name.lower().startswith("cam")}


def _videos(path: Path) -> dict[str, Path]:
    """Return the videos named like cameras: those of the folder itself, or of its subfolder for videos."""
    return _cameras_of(videos_in(path, segmented=True)) or _cameras_of(video_files(path, segmented=True))


def _names(path: Path, found: list[str], rows: int, request: Request, notes: list[str]) -> list[str]:
    """Return the names of the cameras that rows belong to, in the order of their numbers.

    A camera that is left out may have a row or not, and a video or not.
    """
    everything = sorted({*found, *request.left_out}, key=natural_key)
    kept = [name for name in everything if name not in request.left_out]
    names = next((names for names in (everything, found, kept) if len(names) == rows), None)
    if names is None or not kept or not set(kept) <= set(found):
        flat = None if found else flat_images(path) or flat_images(path / "images")
        advice = f" {flat}" if flat else ""
        raise CaptureError(
            f"{path}: {len(found)} videos (cam*.mp4, or of another kind) or folders of images, but {rows} rows in {POSES}. There are "
            f"{', '.join(found) or 'none'}. Rows belong to them in the order of their numbers: add the missing videos, or leave out "
            f"cameras that have no row or no video (--leave-out NAME).{advice}"
        )
    if sorted(names) != names:
        notes.append(f"rows of {POSES} are taken in the order of the cameras' numbers: {', '.join(names)}")
    return names


def _read_poses(file: Path) -> np.ndarray:
    if not file.is_file():
        if (failure := calibration_error(file.parent)) is not None:
            raise failure
        raise CaptureError(
            f"{file}: is missing. A Neu3DV folder needs it beside its videos; LLFF's imgs2poses makes one, and so, as a COLMAP "
            f"model, does `{quoted(['splatreel', 'capture', 'calibrate', file.parent])}`."
        )
    poses = read_array(file, lambda text: CaptureError(f"{text} LLFF's imgs2poses makes one: {EXPECTED}."))
    if poses.ndim != 2 or poses.shape[1] != 17 or poses.dtype.kind not in "fiu":
        raise CaptureError(
            f"{file}: has shape {poses.shape} of {poses.dtype}, expected [cameras, 17] numbers (LLFF). Make it again with LLFF's "
            f"imgs2poses: {EXPECTED}."
        )
    bad = ~np.isfinite(poses).all(1)
    if bad.any():
        raise CaptureError(
            f"{file}: row {int(bad.argmax())} (counted from 0, as the videos by name) holds NaN or infinity. Estimate the pose "
            f"again, or remove the row and its video."
        )
    swapped = poses[:, 15] >= poses[:, 16]
    if swapped.any():
        row = int(swapped.argmax())
        raise CaptureError(
            f"{file}: row {row} (counted from 0, as the videos by name) has the near bound {poses[row, 15]:g} and the far bound "
            f"{poses[row, 16]:g}, which is not farther. The last two numbers of a row are near and far: exchange them."
        )
    return poses.astype(np.float64)


def _camera(path: Path, name: str, size: tuple[int, int], row: np.ndarray) -> Camera:
    """Return a row of poses_bounds as an OpenCV camera of a video's size."""
    matrix = row[:15].reshape(3, 5)
    height, width, focal = matrix[:, 4]
    down, right, back, center = matrix[:, :4].T
    rotation = np.stack([right, down, -back])
    whose = f"{path / POSES}: the row of {name}"
    check_rotation(rotation, f"{whose}: its pose (right, down, forward)")
    if min(height, width, focal) <= 0:
        raise CaptureError(
            f"{whose} is not an LLFF pose: height, width and focal length {height:g}, {width:g}, {focal:g} are not positive, so that "
            f"the lens is unknown. Write the camera's true numbers there, such as by LLFF's imgs2poses; or delete the file and run "
            f"`splatreel capture calibrate`."
        )
    viewmat = np.eye(4)
    viewmat[:3, :3] = rotation
    viewmat[:3, 3] = -rotation @ center
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    return Camera(name, viewmat, K, round(width), round(height)).resized(*size)
