"""Panoptic Sports: CMU Panoptic scenes in the layout of "Dynamic 3D Gaussians" (Luiten et al. 2024).

`train_meta.json` and `test_meta.json` hold w, h, k[t][c], w2c[t][c] (OpenCV), fn[t][c] (path below `ims/`) and
cam_id[t][c].
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatreel.base.errors import CaptureError
from splatreel.base.untrusted import is_number, read_json
from splatreel.capture.base import Request
from splatreel.capture.file_capture import FileCapture
from splatreel.capture.image_sequences import ImageSequences
from splatreel.capture.pose_checks import check_rotation
from splatreel.capture.sidecar import Sidecar
from splatreel.scene.camera import Camera

META = ("train_meta.json", "test_meta.json")
META_BYTES, META_VALUES = 256 << 20, 10_000_000
"""Maximum size of such a file: every frame has a pose and a lens per camera."""


def is_panoptic(path: Path) -> bool:
    """Return whether a folder is a Panoptic Sports folder."""
    return (path / META[0]).is_file()


@dataclass(frozen=True)
class _View:
    camera: Camera
    files: list[str]


class PanopticCapture(FileCapture):
    """Panoptic Sports folder. Cameras are named by number, and those of test_meta.json are held out by default."""

    def __init__(self, path: Path, request: Request) -> None:
        views: list[_View] = []
        defaults: list[str] = []
        for file in META:
            if (path / file).is_file():
                found = _read_meta(path / file)
                views += found
                defaults += [v.camera.name for v in found] if file == "test_meta.json" else []
        views.sort(key=lambda v: int(v.camera.name))
        counts = {v.camera.name: len(v.files) for v in views}
        if len(set(counts.values())) > 1:
            raise CaptureError(f"{path}: cameras have unequal frame counts {counts}; make the two meta files agree.")
        if len(counts) < len(views):
            raise CaptureError(f"{path}: a camera is listed twice in {' and '.join(META)}; remove it from one of them.")
        files = {v.camera.name: _existing(path / "ims", v.files) for v in views}
        super().__init__(
            path,
            [v.camera.resized(*request.size(v.camera.width, v.camera.height, path)) for v in views],
            ImageSequences(path, files, Sidecar(), request),
            request,
            held_out=defaults,
            origin=path / META[0],
            calibrated={v.camera.name: (v.camera.width, v.camera.height) for v in views},
        )


def _existing(folder: Path, files: list[str]) -> list[Path | None]:
    return [folder / name if (folder / name).is_file() else None for name in files]


def _not_panoptic(text: str) -> CaptureError:
    return CaptureError(f"{text} It should be a Panoptic Sports description: copy it again.")


def _read_meta(file: Path) -> list[_View]:
    """Return the cameras of a meta file. A pose that changes over time is an error."""
    meta = read_json(file, _not_panoptic, META_BYTES, META_VALUES)
    try:
        names = [str(int(i)) for i in meta["cam_id"][0]]
        K, w2c = np.asarray(meta["k"], np.float64), np.asarray(meta["w2c"], np.float64)
        width, height, paths = meta["w"], meta["h"], meta["fn"]
        if not (is_number(width) and is_number(height)):
            raise TypeError("w or h is not a number")
        width, height = int(width), int(height)
    except (ValueError, KeyError, TypeError, IndexError, OverflowError) as error:
        raise CaptureError(f"{file}: is not a Panoptic Sports description ({error!r}).") from error
    frames = len(paths)
    for key, value, shape in (("k", K, (3, 3)), ("w2c", w2c, (4, 4))):
        if value.shape != (frames, len(names), *shape):
            raise CaptureError(
                f"{file}: {key} has shape {value.shape}, expected {(frames, len(names), *shape)} "
                f"for {frames} frames and {len(names)} cameras."
            )
        moving = np.abs(value - value[:1]).max((0, 2, 3)) > 1e-4
        if moving.any():
            raise CaptureError(
                f"{file}: {key} of camera {names[int(moving.argmax())]} changes over time; only static cameras work."
            )
    for c, name in enumerate(names):
        if np.isfinite(w2c[0, c]).all():
            check_rotation(w2c[0, c, :3, :3], f"{file}: w2c of camera {name}")
    return [
        _View(Camera(name, w2c[0, c], K[0, c], width, height), [row[c] for row in paths])
        for c, name in enumerate(names)
    ]
