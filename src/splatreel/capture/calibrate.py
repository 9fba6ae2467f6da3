"""Where the cameras of a folder of videos stand, and what their lenses do: a COLMAP model of one moment, by pycolmap."""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from PIL import Image

from splatreel.capture.base import MIN_CAMERAS, Request
from splatreel.capture.colmap import import_pycolmap, is_colmap, video_files
from splatreel.capture.neu3dv import POSES
from splatreel.capture.sidecar import read_sidecar
from splatreel.capture.videos import Videos
from splatreel.errors import CaptureError
from splatreel.progress import Progress
from splatreel.scene.atomic import scratch

MODEL = Path("sparse/0")
FEW = 100
"""Points that a camera sees, below which its place and lens are doubtful."""


@dataclass(frozen=True)
class Calibration:
    """placed: by camera how many points it sees. lost: cameras that could not be placed. error: mean distance in pixels of points
    from where the model says."""

    placed: dict[str, int]
    lost: list[str]
    error: float

    @property
    def doubtful(self) -> list[str]:
        """Cameras that may stand elsewhere."""
        return [name for name, points in self.placed.items() if points < FEW]


def calibrate(path: Path, progress: Progress) -> Calibration:
    """Write the COLMAP model `sparse/0` of a folder of videos, one a camera, from the first frame of each.

    Cameras whose picture has too little in common with the others' are not in it. Raises `CaptureError` where the folder is
    calibrated already, where there are too few videos, or where fewer than three cameras could be placed.
    """
    if is_colmap(path) or (path / POSES).exists():
        raise CaptureError(f"{path}: is calibrated already. Delete {MODEL.parent} or {POSES} to calibrate it anew.")
    files = video_files(path)
    if len(files) < MIN_CAMERAS:
        found = ", ".join(file.name for file in files.values()) or "none"
        raise CaptureError(f"{path}: {len(files)} videos ({found}), at least {MIN_CAMERAS} are needed. Add the others.")
    colmap = import_pycolmap()
    with scratch(path, "calibrate") as folder:
        pictures = folder / "images"
        progress.stage("first frames", len(files))
        _write_pictures(path, files, pictures, progress)
        model = _solve(colmap, folder, len(files), progress)
        images = sorted(model.images.values(), key=lambda image: image.name) if model else []
        placed = {Path(image.name).stem: int(image.num_points3D) for image in images}
        if len(placed) < MIN_CAMERAS:
            raise CaptureError(
                f"{path}: only {len(placed)} of {len(files)} cameras ({', '.join(placed) or 'none'}) show enough in common to "
                f"tell where they stand. Film with neighbouring cameras that see the same things, and with more texture "
                f"around what moves."
            )
        _put(model, folder / "model", path / MODEL)
    lost = sorted(set(files) - set(placed))
    return Calibration(placed, lost, float(model.compute_mean_reprojection_error()))


def _write_pictures(path: Path, files: dict[str, Path], folder: Path, progress: Progress) -> None:
    """The first frame of each video as a PNG of its own size."""
    folder.mkdir()
    videos = Videos(path, files, read_sidecar(path), Request(frames=(0, 1)))
    try:
        for count, name in enumerate(files, 1):
            picture = np.empty((1, videos[name].height, videos[name].width, 3), np.uint8)
            videos.read_camera(picture, 0, name)
            Image.fromarray(picture[0]).save(folder / f"{name}.png", compress_level=1)
            progress.update(count)
    finally:
        videos.close()


def _solve(colmap: ModuleType, folder: Path, count: int, progress: Progress) -> Any:
    """The model that holds the most of the cameras, each with a lens of its own; None if there is none."""
    database, pictures = folder / "features.db", folder / "images"
    colmap.logging.minloglevel = colmap.logging.Level.ERROR.value
    progress.stage("features", 1)
    colmap.extract_features(database, pictures, camera_mode=colmap.CameraMode.PER_IMAGE)
    progress.update(1)
    progress.stage(f"matches of {count * (count - 1) // 2} pairs", 1)
    matching = colmap.FeatureMatchingOptions()
    matching.guided_matching = True  # once two cameras are known roughly, their lines tell where to look for more
    colmap.match_exhaustive(database, matching_options=matching)
    progress.update(1)
    progress.stage("poses", 1)
    models = colmap.incremental_mapping(database, pictures, folder)
    progress.update(1)
    return max(models.values(), key=lambda model: (len(model.images), len(model.points3D)), default=None)


def _put(model: Any, made: Path, place: Path) -> None:
    """Whole or not at all."""
    made.mkdir()
    model.write_binary(str(made))
    place.parent.mkdir(exist_ok=True)
    shutil.rmtree(place, ignore_errors=True)
    os.replace(made, place)
