"""Neural 3D Video folders: one `camNN.mp4` per camera and `poses_bounds.npy` (LLFF).

A row of poses_bounds is a 3x5 matrix, then near and far. The matrix holds camera-to-world axes in the order (down,
right, backwards), the camera center, and (height, width, focal). The principal point is the image center. An optional
`splatreel.json` adds more (`capture/sidecar.py`).
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from splatreel.capture.base import Request
from splatreel.capture.file_capture import FileCapture
from splatreel.capture.pose_checks import check_rotation
from splatreel.capture.readers.calibrated import is_calibrated
from splatreel.capture.readers.colmap import is_colmap, video_files
from splatreel.capture.readers.transforms import is_transforms
from splatreel.capture.sidecar import calibration_error, read_sidecar
from splatreel.capture.sources import Video, video_source
from splatreel.errors import CaptureError
from splatreel.scene.camera import Camera
from splatreel.scene.untrusted import read_array

POSES = "poses_bounds.npy"
EXPECTED = "3x5 pose, near and far in a row"
HELD_OUT = re.compile("cam_?0+")
"""Camera numbered 0: `cam00`, in MeetRoom `cam_0`."""


def is_neu3dv(path: Path) -> bool:
    """Return whether a folder is a Neu3DV folder."""
    others = (is_colmap, is_transforms, is_calibrated)
    return (path / POSES).is_file() or (any(path.glob("cam*.mp4")) and not any(fits(path) for fits in others))


class Neu3DVCapture(FileCapture):
    """Neu3DV folder. By default the camera numbered 0 is held out."""

    def __init__(self, path: Path, request: Request) -> None:
        files = _videos(path)
        poses = _read_poses(path / POSES)
        if len(files) != len(poses):
            raise CaptureError(
                f"{path}: {len(files)} videos (cam*.mp4, or of another kind) but {len(poses)} rows in {POSES}. Rows belong to the "
                f"videos in the order of their names: add the missing videos, or remove the rows of cameras that are not there."
            )
        sidecar, names = read_sidecar(path), list(files)
        videos = video_source(path, files, sidecar, request)
        cameras = [
            _camera(path, name, video, row).resized(*request.size(video.width, video.height, path))
            for name, video, row in zip(names, map(videos.__getitem__, names), poses, strict=True)
        ]
        default = sidecar.held_out if sidecar.held_out is not None else [n for n in names if HELD_OUT.fullmatch(n)]
        super().__init__(
            path,
            cameras,
            videos,
            request,
            held_out=default,
            near=float(poses[:, 15].min()),
            origin=path / POSES,
        )


def _videos(path: Path) -> dict[str, Path]:
    """Return MP4 files by camera, otherwise videos of any type or folders of numbered videos."""
    plain = {file.stem: file for file in sorted(path.glob("cam*.mp4"))}
    return plain or {
        name: file for name, file in sorted(video_files(path, segmented=True).items()) if name.startswith("cam")
    }


def _read_poses(file: Path) -> np.ndarray:
    """Return the checked content of poses_bounds.npy, [C, 17] float64."""
    if not file.is_file():
        if (failure := calibration_error(file.parent)) is not None:
            raise failure
        raise CaptureError(
            f"{file}: is missing. A Neu3DV folder needs it beside its videos; LLFF's imgs2poses makes one, and so, as a COLMAP "
            f"model, does `splatreel capture calibrate {file.parent}`."
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


def _camera(path: Path, name: str, video: Video, row: np.ndarray) -> Camera:
    """Return a row of poses_bounds as an OpenCV camera of the video's size."""
    matrix = row[:15].reshape(3, 5)
    height, width, focal = matrix[:, 4]
    down, right, back, center = matrix[:, :4].T
    rotation = np.stack([right, down, -back])
    whose = f"{path / POSES}: the row of {video.path.name}"
    check_rotation(rotation, f"{whose}: its pose (right, down, forward)")
    if min(height, width, focal) <= 0:
        raise CaptureError(
            f"{whose} is no LLFF pose: its height, width and focal length {height:g}, {width:g}, {focal:g} are not positive. Estimate "
            f"the poses again with LLFF's imgs2poses."
        )
    if abs(width / height * video.height / video.width - 1) > 0.02:
        raise CaptureError(
            f"{video.path}: is {video.width}x{video.height}, but {POSES} is for {width:g}x{height:g}, another aspect ratio."
        )
    viewmat = np.eye(4)
    viewmat[:3, :3] = rotation
    viewmat[:3, 3] = -rotation @ center
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    return Camera(name, viewmat, K, round(width), round(height)).resized(video.width, video.height)
