"""Neural 3D Video folders: one `camNN.mp4` a camera and `poses_bounds.npy` (LLFF).

A row of poses_bounds is a 3x5 matrix, then near and far. The matrix holds camera-to-world axes in the order (down, right,
backwards), the camera centre, and (height, width, focal). The principal point is the image centre.
An optional `splatreel.json` beside the videos may say {"held_out": [camera names], "fps": number}.
"""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from splatreel import threads
from splatreel.capture.base import Capture, Request
from splatreel.capture.video import VideoFile
from splatreel.errors import CaptureError
from splatreel.scene.camera import Camera

POSES = "poses_bounds.npy"
SIDECAR = "splatreel.json"
HELD_OUT = "cam00"


def is_neu3dv(path: Path) -> bool:
    return (path / POSES).is_file() or any(path.glob("cam*.mp4"))


class Neu3DVCapture(Capture):
    """A Neu3DV folder; cam00 is held out unless the request or `splatreel.json` says otherwise."""

    def __init__(self, path: Path, request: Request) -> None:
        files = sorted(path.glob("cam*.mp4"))
        poses = _read_poses(path / POSES)
        if len(files) != len(poses):
            raise CaptureError(
                f"{path}: {len(files)} videos (cam*.mp4) but {len(poses)} rows in {POSES}. Rows belong to the videos in the "
                f"order of their names: add the missing videos, or remove the rows of cameras that are not there."
            )
        sidecar = _read_sidecar(path / SIDECAR)
        self._videos = {f.stem: VideoFile(f) for f in files}
        counts = {name: v.frames for name, v in self._videos.items()}
        if request.frames is None and len(set(counts.values())) > 1:
            low = min(counts, key=lambda n: counts[n])
            high = max(counts, key=lambda n: counts[n])
            raise CaptureError(
                f"{path}: the videos have unequal frame counts: {low}.mp4 has {counts[low]}, {high}.mp4 has {counts[high]}. "
                f"If they start together, choose the frames all of them have: --frames 0:{counts[low]}."
            )
        cameras = [
            _camera(path, video, row).resized(*request.size(video.width, video.height, path))
            for video, row in zip(self._videos.values(), poses, strict=True)
        ]
        default = sidecar.get("held_out", [HELD_OUT] if HELD_OUT in counts else [])
        super().__init__(
            path,
            cameras,
            held_out=default if request.held_out is None else request.held_out,
            frame_range=request.range(min(counts.values(), default=0), path),
            fps=sidecar.get("fps") or next(iter(self._videos.values())).fps or 30.0,
            near=float(poses[:, 15].min()),
        )

    def _read_into(self, out: np.ndarray, first: int, cameras: list[str]) -> None:
        """Cameras are decoded in parallel; FFmpeg works without the interpreter lock."""
        with ThreadPoolExecutor(min(len(cameras), threads.count()) or 1) as pool:
            jobs = [pool.submit(self._videos[name].read_into, out[:, c], first) for c, name in enumerate(cameras)]
            for job in jobs:
                job.result()

    def sources(self) -> list[Path]:
        return [video.path for video in self._videos.values()]

    def close(self) -> None:
        for video in self._videos.values():
            video.close()


def _read_poses(file: Path) -> np.ndarray:
    """poses_bounds.npy as [C, 17] float64, checked."""
    if not file.is_file():
        raise CaptureError(
            f"{file}: is missing. A Neu3DV folder needs it beside its videos; LLFF's imgs2poses makes one."
        )
    try:
        poses = np.load(file, allow_pickle=False)
        if not isinstance(poses, np.ndarray):
            raise ValueError("an archive of several arrays")
    except (OSError, ValueError, EOFError, SyntaxError, MemoryError, BadZipFile) as error:
        raise CaptureError(
            f"{file}: is not a NumPy array file ({error}). Copy it again; LLFF's imgs2poses makes one."
        ) from error
    if poses.ndim != 2 or poses.shape[1] != 17 or poses.dtype.kind not in "fiu":
        raise CaptureError(
            f"{file}: has shape {poses.shape} of {poses.dtype}, expected [cameras, 17] numbers (LLFF). Make it again with LLFF's "
            f"imgs2poses: 3x5 pose, near and far in a row."
        )
    bad = ~np.isfinite(poses).all(1)
    if bad.any():
        raise CaptureError(
            f"{file}: row {int(bad.argmax())} (counted from 0, as the videos by name) holds NaN or infinity. Estimate the pose "
            f"again, or remove the row and its video."
        )
    return poses.astype(np.float64)


def _camera(path: Path, video: VideoFile, row: np.ndarray) -> Camera:
    """One row of poses_bounds as an OpenCV camera of the video's size."""
    matrix = row[:15].reshape(3, 5)
    height, width, focal = matrix[:, 4]
    down, right, back, center = matrix[:, :4].T
    rotation = np.stack([right, down, -back])
    if (
        min(height, width, focal) <= 0
        or np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-2
        or np.linalg.det(rotation) < 0
    ):
        raise CaptureError(
            f"{path / POSES}: the row of {video.path.name} is no LLFF pose: its axes are not a rotation, or its height, width "
            f"and focal length {height:g}, {width:g}, {focal:g} are not positive. Estimate the poses again with LLFF's imgs2poses."
        )
    if abs(width / height * video.height / video.width - 1) > 0.02:
        raise CaptureError(
            f"{video.path}: is {video.width}x{video.height}, but {POSES} is for {width:g}x{height:g}, another aspect ratio."
        )
    viewmat = np.eye(4)
    viewmat[:3, :3] = rotation
    viewmat[:3, 3] = -rotation @ center
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    return Camera(video.path.stem, viewmat, K, round(width), round(height)).resized(video.width, video.height)


def _read_sidecar(file: Path) -> dict:
    if not file.is_file():
        return {}
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        if not isinstance(content, dict):
            raise ValueError("is not a JSON object")
        held_out, fps = content.get("held_out", []), content.get("fps", 30.0)
        if not isinstance(held_out, list) or not all(isinstance(n, str) for n in held_out):
            raise ValueError(f"held_out is {held_out!r:.100}, expected a list of camera names")
        if isinstance(fps, bool) or not isinstance(fps, int | float) or not 0 < fps < float("inf"):
            raise ValueError(f"fps is {fps!r:.100}, expected a positive number")
    except (OSError, ValueError, RecursionError) as error:
        raise CaptureError(f"{file}: {error}. Correct it or remove it.") from error
    return content
